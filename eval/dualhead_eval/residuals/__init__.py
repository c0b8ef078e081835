"""Distances between the heads' chunks, and their split by mode."""
