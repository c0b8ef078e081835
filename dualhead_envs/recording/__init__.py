"""Demonstrations to LeRobotDatasets: atomic shards, one bulk assembly; no environment is known here."""
