"""Intervals, tests, and the summaries of runs and families that carry them."""
