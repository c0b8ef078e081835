"""RotatingRing: a synthetic testbed whose modes are Gaussian, rotate with the condition and are all valid."""
