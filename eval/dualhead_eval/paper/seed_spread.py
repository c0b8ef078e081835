"""The spread of the paper's own seeds: where the normalised effect of one more run of a row is expected."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.stats import t

from dualhead_eval.paper.numbers import PaperNumber, paper_numbers
from dualhead_eval.statistics.interval import Interval

#: Rows that one row of tab:main summarises, whose seeds are printed under names of their own (tab:posterior).
_PARTS = {"v2/E posterior all": "v2/E posterior kl"}


@cache
def seed_spread(row: str, level: float = 0.95) -> Interval | None:
    """Prediction interval for the rho of one more seed of a row; None where the paper prints no spread.

    From the seed expansion (tab:seeds: mean, standard deviation, number of seeds) where it has the row, otherwise from
    the seeds printed one by one. Student's t, widened by the rounding of what is printed.
    """
    expanded = {p.quantity: p for p in paper_numbers() if (p.source, p.row) == ("tab:seeds", row)}
    if {"rho", "rho_sd"} <= set(expanded):
        mean, sd, n = expanded["rho"].value, expanded["rho_sd"].value, expanded["rho"].n
        resolution = expanded["rho"].resolution
    else:
        seeds = printed_seeds(row)
        values = np.array([seed.value for seed in seeds], dtype=float)
        if values.size < 2:
            return None
        mean, sd, n = float(values.mean()), float(values.std(ddof=1)), values.size
        resolution = seeds[0].resolution
    if mean is None or sd is None or n is None:
        return None
    half = float(t.ppf((1 + level) / 2, n - 1)) * sd * np.sqrt(1 + 1 / n) + resolution
    return Interval(float(mean - half), float(mean + half), level)


def printed_seeds(row: str) -> list[PaperNumber]:
    """The rho of each seed of a row, where the paper prints them one by one."""
    prefix = _PARTS.get(row, f"{row}/seed")
    seeds: dict[str, PaperNumber] = {}
    for p in paper_numbers():
        if p.row.startswith(prefix) and "/seed" in p.row and p.quantity == "rho" and p.value is not None:
            seeds.setdefault(p.row, p)
    return list(seeds.values())
