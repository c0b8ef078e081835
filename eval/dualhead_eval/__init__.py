"""From samples of two heads to verdicts: labels, counts, effects, intervals, reports.

The core (effects, counts, aggregation, inference, gate files, certificates) needs NumPy and SciPy alone and
works on anyone's label tables.
"""
