"""The regime gate: do an arm's heads have two modes, a token with entropy, and do they obey it?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.effects.contingency import coordination
from dualhead_eval.studies.monitor.arm_scores import ArmScores
from dualhead_eval.studies.monitor.log_table import MonitorLog
from dualhead_eval.studies.monitor.recording import NOMINAL
from dualhead_eval.studies.monitor.registration import Gate


@dataclass(frozen=True)
class Regime:
    """What an arm offers where two modes are open; of several seeds the mean.

    Attributes:
        decisions: Flagged decisions of nominal test episodes.
        valid: Share of pairs in which both heads reach a mode.
        capacity: C, per decision and then weighted by both-valid pairs.
        delta: Effect, likewise.
        entropy: Mean entropy of the token's prior in nat; None without tokens.
        obedience: Share of valid chunks whose mode is that of their token; None without tokens.
    """

    decisions: int
    valid: float
    capacity: float
    delta: float
    entropy: float | None
    obedience: float | None

    def missed(self, gate: Gate) -> list[str]:
        """Conditions of the gate that are not met, in words; an undefined number meets none."""
        asked = (
            ("capacity", self.capacity, gate.capacity),
            ("token entropy", self.entropy, gate.token_entropy_nat),
            ("obedience", self.obedience, gate.obedience),
        )
        return [f"{name} {value:.2f} < {limit:g}" for name, value, limit in asked
                if value is not None and not value >= limit]  # fmt: skip


def regime(log: MonitorLog, scores: ArmScores, samples: int) -> Regime:
    """The regime of one run."""
    part = np.array(log.episodes["part"])[log.episode]
    nominal = log.flagged & (part == NOMINAL)
    pairs = scores.pairs[nominal].astype(np.int64)
    found = coordination(pairs)
    weight = found.n.astype(np.float64)
    total = weight.sum()

    def mean(values: NDArray) -> float:
        return float((weight * np.where(weight > 0, values, 0.0)).sum() / total) if total else float("nan")

    entropy = obedience = None
    if scores.followed is not None and scores.entropy is not None:
        calibration = log.flagged & log.calibrating[log.episode]
        mode = scores.followed[calibration].sum(axis=(0, 1), dtype=np.int64).argmax(axis=-1)  # of every token
        followed = scores.followed[nominal].sum(axis=(0, 1), dtype=np.int64)
        obeyed = followed[np.arange(len(mode)), mode].sum()
        obedience = float(obeyed / followed.sum()) if followed.sum() else float("nan")
        entropy = float(scores.entropy[nominal].mean()) if nominal.any() else float("nan")
    n = int(nominal.sum())
    valid = float(total / (samples * n)) if n else float("nan")
    return Regime(n, valid, mean(found.capacity), mean(found.delta), entropy, obedience)


def mean_regime(regimes: Sequence[Regime]) -> Regime:
    """The mean over training seeds."""

    def mean(values: Sequence[float | None]) -> float | None:
        defined = [value for value in values if value is not None]
        return float(np.mean(defined)) if len(defined) == len(values) else None

    return Regime(
        decisions=regimes[0].decisions,
        valid=float(np.mean([one.valid for one in regimes])),
        capacity=float(np.mean([one.capacity for one in regimes])),
        delta=float(np.mean([one.delta for one in regimes])),
        entropy=mean([one.entropy for one in regimes]),
        obedience=mean([one.obedience for one in regimes]),
    )
