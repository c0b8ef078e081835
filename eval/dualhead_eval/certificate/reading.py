"""What a coordination certificate says at one moment: estimates, joint bounds, verdict."""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan, nan, sqrt

from dualhead_eval.certificate.pooled_bounds import effect_bounds, gini_bounds
from dualhead_eval.certificate.state import CertificateState
from dualhead_eval.statistics.confidence_sequence import RunningMean
from dualhead_eval.statistics.interval import Interval

VERDICTS = ("insufficient", "uncoordinated", "coordinated", "anti-coordinated", "collapsed", "low-validity")


@dataclass(frozen=True)
class CertificateReading:
    """What the certificate knows at one moment.

    Attributes:
        verdict: One of :data:`VERDICTS`.
        kind: ``"conditional"`` (mean effect within a decision) or ``"pooled"`` (single pairs: contains the
            Simpson term).
        delta: Estimated effect, with ``bounds["delta"]``.
        diversity_q: Head A's diversity G(q), with bounds.
        diversity_p: Head B's diversity G(p), with bounds.
        valid_rate: Share of pairs in which both heads are valid, with bounds.
        capacity: sqrt(diversity_q * diversity_p).
        rho: delta / capacity, NaN without capacity.
        bounds: Intervals by name, jointly valid at all times with probability 1 - alpha.
        decisions: Decisions seen.
        used: Decisions that entered the effect (two both-valid pairs or more; one if pooled).
        guarantee: The kind of guarantee, in words.
    """

    verdict: str
    kind: str
    delta: float
    diversity_q: float
    diversity_p: float
    valid_rate: float
    capacity: float
    rho: float
    bounds: dict[str, Interval]
    decisions: int
    used: int
    guarantee: str


def read_certificate(state: CertificateState) -> CertificateReading:
    """Estimates, bounds that hold jointly and at all times, and the verdict that they support."""
    alpha = state.alpha / state.n_sequences
    largest = 1 - 1 / state.n_modes

    def bounded(mean: RunningMean, low: float, high: float) -> tuple[float, float]:
        bounds = mean.bounds(alpha)
        return max(low, bounds[0]), min(high, bounds[1])

    valid = state.valid.bounds(alpha)
    if state.single:
        q, p = ([mean.mean for mean in means] for means in (state.modes_q, state.modes_p))
        q_bounds, p_bounds = ([m.bounds(alpha) for m in means] for means in (state.modes_q, state.modes_p))
        agreement = state.agreement
        delta = agreement.mean - sum(x * y for x, y in zip(q, p, strict=True))
        diversity_q, diversity_p = 1 - sum(x * x for x in q), 1 - sum(y * y for y in p)
        delta_bounds = effect_bounds(agreement.bounds(alpha), q_bounds, p_bounds)
        q_range, p_range = gini_bounds(q_bounds), gini_bounds(p_bounds)
    else:
        delta, diversity_q, diversity_p = (m.mean for m in (state.delta, state.diversity_q, state.diversity_p))
        delta_bounds = bounded(state.delta, -largest, largest)
        q_range, p_range = (bounded(m, 0.0, largest) for m in (state.diversity_q, state.diversity_p))
    capacity = sqrt(diversity_q * diversity_p) if not isnan(diversity_q) else nan
    capacity_range = sqrt(q_range[0] * p_range[0]), sqrt(q_range[1] * p_range[1])
    ranges = {
        "delta": delta_bounds,
        "diversity_q": q_range,
        "diversity_p": p_range,
        "valid_rate": valid,
        "capacity": capacity_range,
    }
    return CertificateReading(
        verdict=_verdict(state, delta_bounds, capacity_range, valid),
        kind="pooled" if state.single else "conditional",
        delta=delta,
        diversity_q=diversity_q,
        diversity_p=diversity_p,
        valid_rate=state.valid_pairs / state.pairs if state.pairs else nan,
        capacity=capacity,
        rho=delta / capacity if capacity > 0 else nan,
        bounds={name: Interval(low, high, 1 - state.alpha) for name, (low, high) in ranges.items()},
        decisions=state.decisions,
        used=state.agreement.count if state.single else state.delta.count,
        guarantee=(
            f"exact (non-asymptotic), jointly and at all times with probability {1 - state.alpha:g}"
            + ("; pooled effect, contains the conditions' own co-movement (Simpson term)" if state.single else "")
        ),
    )


def _verdict(
    state: CertificateState,
    delta: tuple[float, float],
    capacity: tuple[float, float],
    valid: tuple[float, float],
) -> str:
    """The verdict that every point inside the bounds supports."""
    if valid[1] < state.min_valid_rate:
        return "low-validity"
    collapsed = state.collapse * (1 - 1 / state.n_modes)
    if capacity[1] < collapsed:
        return "collapsed"
    if capacity[0] < collapsed:
        return "insufficient"
    if delta[0] > state.margin * capacity[1]:
        return "coordinated"
    if delta[1] < -state.margin * capacity[1]:
        return "anti-coordinated"
    if -state.margin * capacity[0] < delta[0] and delta[1] < state.margin * capacity[0]:
        return "uncoordinated"
    return "insufficient"
