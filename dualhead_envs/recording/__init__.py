"""Demonstrations to LeRobotDatasets: scripted experts, atomic shards, one bulk assembly."""
