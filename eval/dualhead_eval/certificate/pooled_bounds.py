"""Bounds on the pooled effect and diversities from bounds on agreement and mode frequencies.

With deviations u = q - 1/K and v = p - 1/K, which sum to zero, sum q_k p_k = 1/K + sum u_k v_k and
1 - sum q_k^2 = 1 - 1/K - sum u_k^2: the uncertainty of a frequency is then multiplied by a deviation, not by
a frequency.
"""

from __future__ import annotations

from collections.abc import Sequence

Range = tuple[float, float]


def effect_bounds(agreement: Range, q: Sequence[Range], p: Sequence[Range]) -> Range:
    """Bounds on agreement - sum q_k p_k over all mode frequencies inside the boxes ``q`` and ``p``."""
    low, high = chance_bounds(q, p)
    return agreement[0] - high, agreement[1] - low


def chance_bounds(q: Sequence[Range], p: Sequence[Range]) -> Range:
    """Bounds on the chance agreement sum q_k p_k; exact for two modes, outer ones for more."""
    even = 1 / len(q)
    low = high = even
    for x, y in zip(simplex_box(q), simplex_box(p), strict=True):
        corners = [(a - even) * (b - even) for a in x for b in y]
        low, high = low + min(corners), high + max(corners)
    return max(0.0, low), min(1.0, high)


def gini_bounds(m: Sequence[Range]) -> Range:
    """Bounds on the diversity 1 - sum m_k^2; exact for two modes, outer ones for more."""
    even = 1 / len(m)
    low = high = 1 - even
    for a, b in simplex_box(m):
        ends = (a - even) ** 2, (b - even) ** 2
        low -= max(ends)
        high -= 0.0 if a <= even <= b else min(ends)
    return max(0.0, low), high


def simplex_box(m: Sequence[Range]) -> list[Range]:
    """The smallest box around those frequencies in the box ``m`` that sum to one."""
    lows, highs = sum(low for low, _ in m), sum(high for _, high in m)
    return [(max(low, 1 - (highs - high)), min(high, 1 - (lows - low))) for low, high in m]
