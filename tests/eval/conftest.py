"""One builder of gates, for every test that needs counts of known coordination."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dualhead_eval.effects.counts import joint_table
from dualhead_eval.gate import Gate
from dualhead_eval.residuals.strata import residual_strata

TAUS, NFES = [0.4, 0.55], [10, 20]


def _gate(
    label: str = "run",
    couple: float = 0.0,
    *,
    k: int = 2,
    flip: bool = False,
    heads: int = 2,
    partition: str = "ring",
    valid: float = 1.0,
    weak: bool = False,
    prior: list[float] | None = None,
    seed: int = 0,
    conditions: int = 12,
    pairs: int = 500,
    **provenance: object,
) -> Gate:
    """A gate of labels drawn under a known coupling, scanned at two thresholds and two numbers of steps.

    Args:
        label: Name of the run.
        couple: Probability that a further head copies the first one's mode.
        k: Number of modes.
        flip: Copy the next mode instead, so that the heads avoid each other.
        heads: Number of heads.
        partition: Name of the partition.
        valid: Share of valid pairs at most.
        weak: Let the higher threshold cost some valid pairs.
        prior: Mode frequencies, uniform by default.
        seed: Seed of the labels.
        conditions: Number of conditions.
        pairs: Sampled pairs per condition.
        provenance: Further provenance.
    """
    rng = np.random.default_rng(seed)
    labels = [rng.choice(k, p=prior, size=(conditions, pairs))]
    for _ in range(heads - 1):
        own = rng.choice(k, p=prior, size=(conditions, pairs))
        labels.append(np.where(rng.random(own.shape) < couple, (labels[0] + flip) % k, own))
    strength = rng.random((heads, conditions, pairs)) ** (0.5 if weak else 0.1)
    kept = rng.random((heads, conditions, pairs)) < valid**0.5
    at = np.array([np.where((strength >= tau * 0.5) & kept, labels, -1) for tau in TAUS])
    cut = np.broadcast_to(at, (len(NFES), *at.shape))
    residual = rng.gamma(9, 3, size=(conditions, pairs)) + 100 * (labels[0] != labels[1])
    return Gate(
        heads=("joint", "position", "rotation")[:heads],
        n_modes=k,
        taus=TAUS,
        nfes=NFES,
        reference_tau=0.55,
        reference_nfe=20,
        counts=np.array([[joint_table(list(heads_at), k) for heads_at in row] for row in cut]),
        conditions=np.zeros((conditions, 3)),
        pair_ids=np.arange(conditions),
        provenance={"label": label, "partition": {"name": partition, "n_modes": k}, **provenance},
        strata={"position": residual_strata(np.broadcast_to(residual, cut[:, :, 0].shape), cut[:, :, 0], cut[:, :, 1])},
    )


@pytest.fixture(scope="session")
def make_gate() -> Callable[..., Gate]:
    """The builder, see its arguments above."""
    return _gate
