"""Statistics of one contingency table of two heads' modes; NumPy alone."""

from dualhead_eval.effects.contingency import Coordination, coordination

__all__ = ["Coordination", "coordination"]
