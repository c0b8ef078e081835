"""Thresholds by name, with their option after a colon: ``conformal:random-step``, ``band:stdev``, ``mondrian``."""

from __future__ import annotations

from typing import Any

from dualhead_eval.monitor.thresholds.conformal import SplitConformal
from dualhead_eval.monitor.thresholds.functional_band import FunctionalBand
from dualhead_eval.monitor.thresholds.mondrian import Mondrian
from dualhead_eval.monitor.thresholds.threshold import Threshold

#: Every threshold by its name.
THRESHOLDS: dict[str, type[Threshold]] = {kind.name: kind for kind in (SplitConformal, FunctionalBand, Mondrian)}


def make_threshold(name: str, **options: Any) -> Threshold:
    """A threshold by its name, and its option after a colon.

    Raises:
        ValueError: If there is no such threshold or option.
    """
    kind, _, option = name.partition(":")
    if kind not in THRESHOLDS:
        raise ValueError(f"threshold {name!r} is not known, expected one of {sorted(THRESHOLDS)}, with its option")
    return THRESHOLDS[kind](*([option] if option else []), **options)
