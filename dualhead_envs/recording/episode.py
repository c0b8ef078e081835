"""One finished demonstration, as recorders hand it to shards and to the assembly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Episode:
    """T frames of one demonstration and what the evaluator needs to know about it.

    Attributes:
        observation_state: Proprioception (T, s), float32.
        environment_state: Task context (T, e), float32.
        action: Dual action vector (T, D), float32; row t is the measured state at t + 1.
        mode: The mode that the expert followed, the same in every frame.
        pair: Identifies the initial state; demonstrations from one state share it.
        branch_step: Frame b of the branch point; the window is the actions of frames b to b + 15.
        extra: Further numbers about the episode, for the geometry card.

    Raises:
        ValueError: If the arrays differ in length, are empty, or hold a number that is not finite.
    """

    observation_state: np.ndarray
    environment_state: np.ndarray
    action: np.ndarray
    mode: int
    pair: int
    branch_step: int
    extra: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        arrays = {name: getattr(self, name) for name in ("observation_state", "environment_state", "action")}
        lengths = {name: array.shape[0] for name, array in arrays.items() if array.ndim == 2}
        if len(lengths) != len(arrays) or len(set(lengths.values())) != 1 or not len(self):
            shapes = {name: array.shape for name, array in arrays.items()}
            raise ValueError(f"an episode has arrays of shapes {shapes}, expected (T, width) with one T > 0")
        for name, array in arrays.items():
            if not np.isfinite(array).all():
                raise ValueError(f"an episode of pair {self.pair} has NaN or infinity in {name}: do not record it")

    def __len__(self) -> int:
        return self.action.shape[0]
