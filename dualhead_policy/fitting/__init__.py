"""What a new policy takes from its training data."""
