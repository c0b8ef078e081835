"""Action-chunk entropy (FIPER): how many cells of a grid the samples of a head occupy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.monitor.decision import Decision
from dualhead_eval.monitor.signals.signal import Signal

#: Side of a cell as a share of a dimension's range over the decisions that it was fitted on.
CELL_SHARE = 0.03


def chunk_entropy_bits(samples: NDArray[np.float64], cell: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shannon entropy in bits of the joint cells of ``samples`` (n, H, d) at every step: (H,).

    The grid begins at the decision's smallest coordinate in each dimension; a dimension whose cell is zero wide never
    varied and is left out.
    """
    used = cell > 0
    if not used.any():
        return np.zeros(samples.shape[1])
    origin = samples.min(axis=(0, 1))
    index = np.floor((samples - origin)[..., used] / cell[used])
    # Same cell of both samples in every dimension: (n, n, H); each sample's cell is shared by that many.
    shared = (index[:, None] == index[None]).all(axis=-1).sum(axis=1)
    return -np.log2(shared / len(samples)).mean(axis=0)


class _ChunkEntropy(Signal):
    unit, needs, learns = "bit", frozenset({"pairs", "samples"}), True
    head: int

    def __init__(self, over_steps: str = "mean") -> None:
        if over_steps not in ("mean", "sum"):
            raise ValueError(f"over_steps={over_steps!r}, expected 'mean' or 'sum'")
        self.over_steps = over_steps
        self.cell: NDArray[np.float64] | None = None

    def fit(self, decisions: Sequence[Decision], rng: np.random.Generator) -> None:
        """Take the range of every dimension over the decisions."""
        samples = np.stack(
            [decision.pair[self.head].reshape(-1, decision.pair[self.head].shape[-1]) for decision in decisions]
        )
        samples = samples[np.isfinite(samples).all(axis=(1, 2))]
        if not len(samples):
            raise ValueError(f"{self.name} found no finite chunk to learn from, expected recorded successes")
        self.cell = CELL_SHARE * np.ptp(samples, axis=(0, 1))

    def score(self, decision: Decision) -> float:
        """Entropy of the cells, mean (or sum) over the window, in bits."""
        samples = decision.pair[self.head]
        if self.cell is None:
            raise ValueError(f"{self.name} has not been fitted, expected a call of fit before the first score")
        if not np.isfinite(samples).all():
            return float("nan")
        entropy = chunk_entropy_bits(samples, self.cell)
        return float(entropy.mean() if self.over_steps == "mean" else entropy.sum())

    def options(self) -> dict[str, Any]:
        """How steps are combined."""
        return {"over_steps": self.over_steps}

    def learned(self) -> dict[str, NDArray]:
        """Side of a cell by dimension, in m."""
        return {} if self.cell is None else {"cell": self.cell}

    def restore(self, arrays: dict[str, NDArray]) -> None:
        """Take the cells back."""
        self.cell = arrays["cell"]


class PositionEntropy(_ChunkEntropy):
    """Entropy of head B's chunks."""

    name, head = "ace_position", 1


class JointEntropy(_ChunkEntropy):
    """Entropy of head A's chunks, as positions."""

    name, head = "ace_joint", 0
