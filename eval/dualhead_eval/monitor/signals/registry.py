"""Signals by name."""

from __future__ import annotations

from typing import Any

from dualhead_eval.monitor.signals.density import FlowDensity
from dualhead_eval.monitor.signals.distillation import RandomDistillation
from dualhead_eval.monitor.signals.ensemble import ActionDistance, VelocityFieldDifference
from dualhead_eval.monitor.signals.entropy import JointEntropy, PositionEntropy
from dualhead_eval.monitor.signals.labels import Diverged, Elapsed, Invalid, Mismatch
from dualhead_eval.monitor.signals.observation import LargestDeviation
from dualhead_eval.monitor.signals.residual import (
    EnergyResidual,
    ExecutedResidual,
    MatchedResidual,
    Residual,
    ResidualMean,
)
from dualhead_eval.monitor.signals.signal import Signal
from dualhead_eval.monitor.signals.temporal import ChunkConsistency, JointConsistency, PositionConsistency, Tracking
from dualhead_eval.monitor.signals.variance import JointVariance, PositionVariance

_CLASSES: tuple[type[Signal], ...] = (
    Residual,
    ExecutedResidual,
    ResidualMean,
    MatchedResidual,
    EnergyResidual,
    LargestDeviation,
    RandomDistillation,
    FlowDensity,
    PositionEntropy,
    JointEntropy,
    PositionVariance,
    JointVariance,
    PositionConsistency,
    JointConsistency,
    ChunkConsistency,
    Tracking,
    ActionDistance,
    VelocityFieldDifference,
    Mismatch,
    Invalid,
    Diverged,
    Elapsed,
)
#: Every signal by its name.
SIGNALS: dict[str, type[Signal]] = {signal.name: signal for signal in _CLASSES}


def make_signal(name: str, **options: Any) -> Signal:
    """A signal by its name.

    Raises:
        ValueError: If there is no such signal, or it does not know an option.
    """
    if name not in SIGNALS:
        raise ValueError(f"signal {name!r} is not known, expected one of {sorted(SIGNALS)}: choose one of these")
    try:
        return SIGNALS[name](**options)
    except TypeError as error:
        raise ValueError(f"signal {name!r} does not take {sorted(options)} ({error}): leave these out") from error
