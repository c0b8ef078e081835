"""Policies of LeRobot's other types: opened from a folder or hub without running its code, and sampled in chunks."""
