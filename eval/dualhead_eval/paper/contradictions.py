"""Contradictions between the paper's printed numbers, computed from the numbers themselves.

Every printed figure stands for the interval that rounds to it. A contradiction is reported only where no values inside
these intervals agree, so that rounding alone never makes one.
"""

from __future__ import annotations

from collections import defaultdict
from functools import cache
from itertools import combinations

import numpy as np

from dualhead_eval.effects.contingency import coordination
from dualhead_eval.effects.dependence import entropy
from dualhead_eval.paper.numbers import PaperNumber, paper_numbers
from dualhead_eval.paper.seed_spread import printed_seeds

#: Tables whose figures describe the same runs in the same convention.
_SAME_RUNS = ("tab:main", "tab:v3", "tab:percond-v2", "tab:percond-v3")
_QUANTITIES = ("obs", "BL", "delta", "C", "rho", "valid_pair_rate")
_TOKENS = ("H ", "I ", "J ", "Jp ", "K ", "window token")

Figures = dict[str, PaperNumber]


@cache
def contradictions(row: str) -> tuple[str, ...]:
    """Statements about a row and its seeds that cannot be true together; empty if there are none.

    Args:
        row: The paper's row, for example ``"v2/H episode token uniform"``.
    """
    if not row:
        return ()
    places: dict[str, list[str]] = defaultdict(list)
    for name in (row, *_seeds(row)):
        for source, figures in _by_source(name).items():
            where = f"{source}{name.removeprefix(row).replace('/', ' ')}"
            for text in (*_ratio(figures), *_sum(figures), *_bound(figures), *_marginal(name, figures)):
                places[text].append(where)
    found = [f"{', '.join(where)}: {text}" for text, where in places.items()]
    return (*found, *_between_tables(row), *_expansion(row), *_range(row))


def _seeds(row: str) -> list[str]:
    return sorted({p.row for p in paper_numbers() if p.row.startswith(f"{row}/seed")})


def _by_source(name: str) -> dict[str, Figures]:
    sources: dict[str, Figures] = defaultdict(dict)
    for p in paper_numbers():
        if p.row == name and p.value is not None:
            # A table's own cell counts before what its caption repeats.
            sources[p.source].setdefault(p.quantity, p)
    return sources


def _ends(p: PaperNumber) -> tuple[float, float]:
    assert p.value is not None
    return p.value - p.resolution, p.value + p.resolution


def _ratio(figures: Figures) -> list[str]:
    """The normalised effect is the effect over its capacity."""
    found = []
    for suffix in ("", "_hv", "_bv"):
        names = [name + suffix for name in ("delta", "C", "rho")]
        if not all(name in figures for name in names):
            continue
        delta, capacity, rho = (figures[name] for name in names)
        # A mean of the seeds' ratios, where a table says so, need not be the ratio of the means.
        if ("mean of seed ratios" in rho.note and (rho.n or 0) > 1) or not capacity.value:
            continue
        quotients = [d / c for d in _ends(delta) for c in _ends(capacity) if c > 0]
        low, high = _ends(rho)
        if quotients and (min(quotients) > high or max(quotients) < low):
            found.append(
                f"rho {_percent(rho)} beside delta / C = {delta.value:+.4f} / {capacity.value:.4f} = "
                f"{(delta.value or 0) / capacity.value:+.1%}"
            )
    return found


def _sum(figures: Figures) -> list[str]:
    """The effect is the mismatch expected by chance less the one observed."""
    if not {"obs", "BL", "delta"} <= set(figures):
        return []
    obs, chance, delta = (figures[name] for name in ("obs", "BL", "delta"))
    gap = (chance.value or 0) - (obs.value or 0)
    if abs(gap - (delta.value or 0)) <= obs.resolution + chance.resolution + delta.resolution + 1e-12:
        return []
    return [f"delta {delta.value:+.4f} beside BL - obs = {gap:+.4f}"]


def _bound(figures: Figures) -> list[str]:
    """No effect exceeds its capacity."""
    found = []
    if {"delta", "C"} <= set(figures):
        delta, capacity = figures["delta"], figures["C"]
        if min(map(abs, _ends(delta))) > _ends(capacity)[1]:
            effect = f"|delta| {abs(delta.value or 0):.4f} exceeds C {capacity.value:.4f}"
            found.append(f"{effect}, which head-valid marginals allow")
    rho = figures.get("rho")
    if rho is not None and _ends(rho)[0] > 1:
        found.append(f"rho {_percent(rho)} exceeds 1, which head-valid marginals allow")
    return found


def _between_tables(row: str) -> list[str]:
    """Two tables that describe the same runs print the same figure."""
    sources = {name: figures for name, figures in _by_source(row).items() if name in _SAME_RUNS}
    found = []
    for (one, first), (other, second) in combinations(sources.items(), 2):
        for name in _QUANTITIES:
            if name not in first or name not in second or first[name].n != second[name].n:
                continue
            a, b = first[name], second[name]
            if abs((a.value or 0) - (b.value or 0)) > a.resolution + b.resolution + 1e-12:
                found.append(f"{name} {a.value:g} in {one}, {b.value:g} in {other}")
    return found


def _expansion(row: str) -> list[str]:
    """The seed expansion holds the original seeds, whose spread its own cannot fall below."""
    expanded = _by_source(row).get("tab:seeds", {})
    if not {"rho", "rho_sd"} <= set(expanded):
        return []
    mean, sd = expanded["rho"], expanded["rho_sd"]
    seeds = printed_seeds(row)
    if not seeds or mean.n is None or mean.n < len(seeds):
        return []
    least = smallest_sd([seed.value or 0 for seed in seeds], _ends(mean), mean.n, seeds[0].resolution)
    if least <= _ends(sd)[1]:
        return []
    values = ", ".join(_percent(seed) for seed in seeds)
    return [
        f"tab:seeds: {mean.n} seeds that hold {values} and have mean {_percent(mean)} differ by at least sd "
        f"{100 * least:.2f}, printed {100 * (sd.value or 0):.2f}"
    ]


def smallest_sd(known: list[float], mean: tuple[float, float], n: int, resolution: float = 0.0) -> float:
    """Smallest standard deviation of ``n`` values that hold the ``known`` ones and have a mean in ``mean``.

    The other values do best all at one place: the one that gives the mean.

    Args:
        known: Some of the values, as printed.
        mean: Smallest and largest mean.
        n: Number of values, at least as many as are known.
        resolution: Rounding of the known values.

    >>> round(smallest_sd([0.0, 1.0], (0.5, 0.5), 2), 4)
    0.7071
    """
    values = np.array(known)
    centre = float(np.clip(values.mean(), *mean))
    # Rounding may have moved every value away from the mean.
    values = values - np.sign(values - centre) * np.minimum(np.abs(values - centre), resolution)
    squares = float(((values - centre) ** 2).sum())
    others = n - len(known)
    if others:
        squares += float((values - centre).sum()) ** 2 / others
    return float(np.sqrt(squares / (n - 1)))


def _range(row: str) -> list[str]:
    """The claims' range of the token families holds each of their rows."""
    stated = next(p for p in paper_numbers() if (p.source, p.row) == ("tab:claims", "robot/token families"))
    environment, _, family = row.partition("/")
    rho = _first({s: f for s, f in _by_source(row).items() if s in _SAME_RUNS}).get("rho")
    if environment not in ("v2", "v3") or not family.startswith(_TOKENS) or rho is None or stated.low is None:
        return []
    if _ends(rho)[1] >= stated.low - 0.0005:
        return []
    return [f"tab:claims: robot-side tokens reach {stated.low:.1%} to {stated.high:.0%}, this row {_percent(rho)}"]


def _marginal(row: str, figures: Figures) -> list[str]:
    """Capacity and entropy of a head are at most those that its printed mode frequencies allow."""
    modes = [p for p in paper_numbers() if p.row.startswith(f"{row}/mode") and p.quantity == "generated_marginal"]
    if not modes:
        return []
    resolution = modes[0].resolution
    frequencies = np.array([p.value for p in modes], dtype=float)
    # As even as rounding allows: the largest mode lower, the smallest higher.
    frequencies[frequencies.argmax()] -= resolution
    frequencies[frequencies.argmin()] += resolution
    counts = np.diag(np.rint(frequencies * 1e6).astype(np.int64))
    largest = {
        "C_rel": float(coordination(counts).capacity) / (1 - 1 / len(modes)),
        "entropy_rel": float(entropy(frequencies)) / float(np.log(len(modes))),
    }
    shown = ", ".join(f"{p.value:.4f}" for p in modes)
    return [
        f"mode frequencies [{shown}] allow {name} at most {most:.4f}, printed {figures[name].value:g}"
        for name, most in largest.items()
        if name in figures and _ends(figures[name])[0] > most
    ]


def _first(sources: dict[str, Figures]) -> Figures:
    return next(iter(sources.values()), {})


def _percent(p: PaperNumber) -> str:
    decimals = max(0, round(-np.log10(2 * p.resolution)) - 2)
    return f"{100 * (p.value or 0):+.{decimals}f}%"
