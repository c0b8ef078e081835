"""Sweeps: configurations x datasets x seeds, trained in stacked groups, resumable at any moment."""
