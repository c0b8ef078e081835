"""Runtime failure monitors of a policy with two heads: signals, thresholds, alarms, and how well they detect."""

from dualhead_eval.monitor.decision import Decision, Episode
from dualhead_eval.monitor.monitor import Monitor, Reading

__all__ = ["Decision", "Episode", "Monitor", "Reading"]
