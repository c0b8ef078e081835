"""Disagreement of an ensemble's members, as in :mod:`dualhead_eval.ensembles.scores`, averaged over ordered pairs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.ensembles.scores import action_l2
from dualhead_eval.monitor.decision import Decision
from dualhead_eval.monitor.signals.signal import Signal


def ordered_pairs_mean(scores: NDArray[np.float64]) -> float:
    """Mean of ``(M, M, ...)`` over i != j and everything else."""
    return float(scores[~np.eye(len(scores), dtype=bool)].mean())


class ActionDistance(Signal):
    """Mean distance between the members' chunks."""

    name, unit, needs = "action_l2", "mm", frozenset({"members"})

    def score(self, decision: Decision) -> float:
        """Mean over ordered pairs of members, samples and steps, in mm."""
        if decision.members is None:
            raise ValueError("action_l2 needs chunks of two members or more, expected Decision.members: leave it out")
        return 1000.0 * ordered_pairs_mean(action_l2(decision.members))


class VelocityFieldDifference(Signal):
    """VFD of the members' velocity fields."""

    name, unit, needs = "vfd", "1", frozenset({"members"})

    def score(self, decision: Decision) -> float:
        """Mean over ordered pairs of members and samples."""
        if decision.member_fields is None:
            raise ValueError("vfd needs velocity fields of two members, expected Decision.member_fields: leave it out")
        return ordered_pairs_mean(np.asarray(decision.member_fields, dtype=np.float64))
