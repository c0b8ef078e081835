"""The decisive monitor experiment: does coordination take false alarms away, does matching do so alone?"""
