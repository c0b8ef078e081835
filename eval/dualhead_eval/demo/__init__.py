"""The demo: record, train, evaluate beside the exact reference, and tell what was seen."""
