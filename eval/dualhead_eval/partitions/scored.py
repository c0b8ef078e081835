"""Any partition, checked and with a score: what the evaluator labels paths with."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from dualhead_envs.validated_json import LONGEST_LABEL, shown
from dualhead_eval.effects.counts import validate_labels
from dualhead_eval.partitions.partition import Partition

#: Names by which reports recognise our own environments' partitions, and which rows stand beside the paper's.
TAKEN = ("ring", "bypass-v2", "bypass-v2-three-ways", "rotating-v3", "labels")


class ScoredPartition:
    """A partition of one's own behind the evaluator's interface; its answers are checked at every call.

    A partition that only assigns has no strength: its valid paths count as infinitely strong, so that it can be counted
    at its own threshold alone.

    Args:
        partition: Anything with ``assign``, ``n_modes``, ``tau`` and ``to_dict``; with ``score`` where it has one.

    Attributes:
        n_modes: Its number of modes.
        tau: Its threshold.
        has_score: Whether other thresholds can be told.

    Raises:
        ValueError: If it lacks one of these, or they contradict each other.
    """

    def __init__(self, partition: Partition) -> None:
        kind = type(partition).__name__
        missing = [name for name in ("assign", "n_modes", "tau", "to_dict") if not hasattr(partition, name)]
        if missing:
            raise ValueError(
                f"{kind} is no mode partition: it lacks {missing[0]!r}, expected assign(path, condition, tau), "
                "n_modes, tau and to_dict(); see dualhead_eval.partitions.partition"
            )
        self._own = partition
        self.n_modes, self.tau = partition.n_modes, partition.tau
        if type(self.n_modes) is not int or not 2 <= self.n_modes <= 1000:
            raise ValueError(f"{kind} has n_modes={shown(self.n_modes)}, expected a number of modes from 2 to 1000")
        if not isinstance(self.tau, int | float) or not 0 <= self.tau < float("inf"):
            raise ValueError(f"{kind} has tau={shown(self.tau)}, expected a finite threshold of at least 0")
        self.has_score = callable(getattr(partition, "score", None))
        self.description = _description(partition, kind)

    def to_dict(self) -> dict[str, Any]:
        """The partition's own description."""
        return self.description

    def assign(self, path: np.ndarray, condition: np.ndarray) -> np.ndarray:
        """Labels (...) at the partition's own threshold."""
        label, strength = self.score(path, condition)
        return np.where(strength >= self.tau, label, -1)

    def score(self, path: np.ndarray, condition: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Labels (...) and strengths (...) of paths (..., H, d) under conditions (..., C).

        Raises:
            ValueError: If the partition answers with another shape, or with what is no label.
        """
        leading = np.broadcast_shapes(np.shape(path)[:-2], np.shape(condition)[:-1])
        if self.has_score:
            label, strength = (np.asarray(answer) for answer in self._own.score(path, condition))  # type: ignore[attr-defined]
        else:
            label = np.asarray(self._own.assign(path, condition, self.tau))
            strength = np.where(label >= 0, np.inf, -np.inf) if label.dtype.kind in "iuf" else label
        kind = type(self._own).__name__
        for what, answer in (("labels", label), ("strengths", strength)):
            if answer.shape != leading:
                raise ValueError(
                    f"{kind} gives {what} of shape {answer.shape} for paths {np.shape(path)}, expected {leading}: "
                    "vectorise it over the leading axes"
                )
        if np.isnan(strength).any():
            raise ValueError(f"{kind} gives a strength that is NaN, expected numbers: give -inf where there is none")
        return validate_labels(label, self.n_modes), strength


def _description(partition: Partition, kind: str) -> dict[str, Any]:
    description = partition.to_dict()
    try:
        plain = json.loads(json.dumps(description, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{kind}.to_dict() is not plain JSON ({error}): give numbers, strings and lists") from error
    name = plain.get("name") if isinstance(plain, dict) else None
    if not isinstance(name, str) or not 0 < len(name) <= LONGEST_LABEL or not name.isprintable():
        raise ValueError(f"{kind}.to_dict() has the name {shown(name)}, expected a line of text: name the partition")
    ours = type(partition).__module__.startswith("dualhead_envs.")
    if name in TAKEN and not ours:
        raise ValueError(f"{kind} is named {name!r}, which is taken, expected another name: rename it in to_dict()")
    for key, own in (("n_modes", partition.n_modes), ("tau", partition.tau)):
        if plain.setdefault(key, own) != own:
            raise ValueError(f"{kind}.to_dict() has {key}={shown(plain[key])}, the partition {own}: make them the same")
    return plain
