"""Bounds on the pooled effect and diversities from bounds on agreement and mode frequencies."""

from __future__ import annotations

from collections.abc import Sequence

Range = tuple[float, float]


def effect_bounds(agreement: Range, q: Sequence[Range], p: Sequence[Range]) -> Range:
    """Bounds on agreement - sum q_k p_k over all mode frequencies inside the boxes ``q`` and ``p``."""
    low, high = chance_bounds(q, p)
    return agreement[0] - high, agreement[1] - low


def chance_bounds(q: Sequence[Range], p: Sequence[Range]) -> Range:
    """Bounds on the chance agreement sum q_k p_k; exact for two modes, outer ones for more."""
    if len(q) == 2:
        a, b = simplex_box(q), simplex_box(p)
        corners = [x * y + (1 - x) * (1 - y) for x in a for y in b]
        return min(corners), max(corners)
    low = sum(x[0] * y[0] for x, y in zip(q, p, strict=True))
    high = sum(x[1] * y[1] for x, y in zip(q, p, strict=True))
    return low, min(1.0, high)


def gini_bounds(m: Sequence[Range]) -> Range:
    """Bounds on the diversity 1 - sum m_k^2; exact for two modes, outer ones for more."""
    if len(m) == 2:
        low, high = simplex_box(m)
        ends = 2 * low * (1 - low), 2 * high * (1 - high)
        return min(ends), 0.5 if low <= 0.5 <= high else max(ends)
    largest = 1 - 1 / len(m)
    low = max(0.0, 1 - sum(high**2 for _, high in m))
    return low, min(largest, 1 - sum(low**2 for low, _ in m))


def simplex_box(m: Sequence[Range]) -> Range:
    """Range of the first of two frequencies that sum to one, from the ranges of both."""
    (low, high), (other_low, other_high) = m
    return max(low, 1 - other_high), min(high, 1 - other_low)
