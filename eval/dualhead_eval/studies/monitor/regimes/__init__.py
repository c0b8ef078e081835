"""The regime sweep on the ring: where disagreement costs false alarms, and when shared tokens take them away."""
