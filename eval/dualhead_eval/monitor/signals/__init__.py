"""Signals: one number per decision, larger when the policy looks worse."""

from dualhead_eval.monitor.signals.registry import SIGNALS, make_signal
from dualhead_eval.monitor.signals.signal import Signal

__all__ = ["SIGNALS", "Signal", "make_signal"]
