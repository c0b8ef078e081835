"""Agreement of all heads at once (tab:pose): do three representations choose one mode together?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualhead_eval.effects.counts import all_valid_agreement
from dualhead_eval.gate import Gate
from dualhead_eval.statistics.bootstrap import BOOTSTRAP_DRAWS, BOOTSTRAP_SEED, Resamples, resample_weights
from dualhead_eval.statistics.interval import Interval


@dataclass(frozen=True)
class HeadAgreement:
    """Agreement of all heads of a run.

    Attributes:
        n_heads: Number of heads.
        valid_rate: Share of samples in which every head is valid.
        rate: Among those, share in which all chose one mode (weighted mean over conditions).
        interval: 95% condition-bootstrap interval of ``rate``.
        chance: The rate expected if the heads chose independently from each condition's own marginals.
    """

    n_heads: int
    valid_rate: float
    rate: float
    interval: Interval
    chance: float


def all_heads_agreement(
    gate: Gate,
    *,
    tau: float | None = None,
    nfe: int | None = None,
    draws: int = BOOTSTRAP_DRAWS,
    seed: int = BOOTSTRAP_SEED,
) -> HeadAgreement:
    """Agreement of all heads of ``gate`` at one operating point.

    Raises:
        KeyError: If the operating point was not evaluated.
    """
    table, heads = gate.table(tau, nfe), len(gate.heads)
    valid, agreeing = all_valid_agreement(table, heads)
    cube = table[(slice(None), *(slice(None, -1),) * heads)].astype(np.float64)
    product = np.ones((len(table), gate.n_modes))
    for head in range(heads):
        others = tuple(axis for axis in range(1, heads + 1) if axis != head + 1)
        product *= cube.sum(axis=others)
    expected = np.divide(product.sum(axis=1), valid ** (heads - 1.0), out=np.zeros(len(valid)), where=valid > 0)

    def over(numerator: np.ndarray, denominator: np.ndarray) -> np.ndarray:
        return np.divide(numerator, denominator, out=np.full(np.shape(numerator), np.nan), where=denominator > 0)

    weights = resample_weights(len(table), draws, np.random.default_rng(seed))
    replicates = Resamples({"rate": over(weights @ agreeing, weights @ valid)})
    totals = [np.asarray(x.sum(), dtype=np.float64) for x in (valid, agreeing, expected)]
    return HeadAgreement(
        n_heads=heads,
        valid_rate=float(over(totals[0], np.asarray(table.sum(), dtype=np.float64))),
        rate=float(over(totals[1], totals[0])),
        interval=replicates.interval("rate", 0.95),
        chance=float(over(totals[2], totals[0])),
    )
