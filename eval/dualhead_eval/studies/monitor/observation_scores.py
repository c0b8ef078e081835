"""Signals of the observation alone on the log: the same for every arm, and the control of the paper's tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dualhead_eval.monitor.decision import Decision
from dualhead_eval.monitor.monitor import LEARNING_SHARE
from dualhead_eval.monitor.recorded_episodes import OBSERVATIONS, training_decisions
from dualhead_eval.monitor.signals.registry import make_signal
from dualhead_eval.studies.monitor.arm_scores import ArmScores
from dualhead_eval.studies.monitor.log_table import MonitorLog

#: Name under which these scores are kept.
OBSERVING = "observation"
#: Signals that know the training split, and those that learn from a share of the calibration episodes.
FROM_TRAINING, FROM_CALIBRATION = ("max_abs_z",), ("rnd", "logpzo")


def learning_episodes(log: MonitorLog, seed: int) -> frozenset[int]:
    """Calibration episodes that signals learn from; thresholds leave them out."""
    calibrating = np.flatnonzero(log.calibrating)
    order = np.random.default_rng(seed).permutation(calibrating)
    return frozenset(order[: int(len(order) * LEARNING_SHARE)].tolist())


def score_observations(log: MonitorLog, training: Path, seed: int) -> ArmScores:
    """Score the log's observations.

    Args:
        log: The log.
        training: The training split.
        seed: Of what learns and of the networks.
    """
    rows = np.concatenate([log.observations[key] for key in OBSERVATIONS], axis=1).astype(np.float64)
    decisions = [Decision(int(step), row) for step, row in zip(log.step, rows, strict=True)]
    chosen = np.isin(log.episode, list(learning_episodes(log, seed)))
    learning = [decision for decision, used in zip(decisions, chosen, strict=True) if used]
    names = [*FROM_TRAINING, *FROM_CALIBRATION]
    scored = ArmScores.empty(len(log), names, 2, None, {"learned from": "a share of the calibration episodes"})
    for name in names:
        signal = make_signal(name)
        rng = np.random.default_rng(seed)
        signal.fit(training_decisions(training) if name in FROM_TRAINING else learning, rng)
        scored.scores[name][:] = [signal.score(decision) for decision in decisions]
    return scored
