"""What a coordination certificate says at one moment: estimates, joint bounds, verdict."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isnan, nan, sqrt
from typing import Any

from dualhead_eval.certificate.pooled_bounds import effect_bounds, gini_bounds
from dualhead_eval.certificate.state import CertificateState
from dualhead_eval.effects.sites import Occupancy, sites_within
from dualhead_eval.effects.unbiased import PRODUCT_PAIRS
from dualhead_eval.statistics.interval import Interval

VERDICTS = ("insufficient", "uncoordinated", "coordinated", "anti-coordinated", "collapsed", "low-validity")

Range = tuple[float, float]


@dataclass(frozen=True)
class CertificateReading:
    """What the certificate knows at one moment.

    Attributes:
        verdict: One of :data:`VERDICTS`; of single pairs only ``collapsed``, ``low-validity`` or ``insufficient``.
        occupancy: The site of the attainable region that the bounds lie in (it tells coordination in part from
            coordination in full); None where they touch several.
        reason: Why the verdict is not a firmer one, in a sentence; empty if it is.
        kind: ``"conditional"`` (mean effect within a decision) or ``"pooled"`` (single pairs: contains the
            Simpson term).
        delta: Estimated effect, with ``bounds["delta"]``.
        diversity_q: Head A's diversity G(q), with bounds.
        diversity_p: Head B's diversity G(p), with bounds.
        valid_rate: Mean over decisions of the share of pairs in which both heads are valid, with bounds.
        capacity: Estimated mean over decisions of sqrt(G(q) G(p)), with bounds from both sides; errs upwards.
        rho: delta / capacity, NaN without capacity; errs towards zero.
        bounds: Intervals by name, jointly valid at all times with probability 1 - alpha.
        decisions: Decisions seen.
        used: Decisions that entered the effect (two both-valid pairs or more; one if pooled).
        guarantee: The kind of guarantee, in words.
    """

    verdict: str
    occupancy: Occupancy | None
    reason: str
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

    def summary(self) -> dict[str, Any]:
        """What a robot's ``info`` says of it: verdict, why it is not a firmer one, and estimates."""
        names = ("verdict", "reason", "delta", "capacity", "valid_rate", "decisions")
        return {name: getattr(self, name) for name in names}


def read_certificate(state: CertificateState) -> CertificateReading:
    """Estimates, bounds that hold jointly and at all times, and the verdict that they support."""
    largest = 1 - 1 / state.n_modes
    valid = state.bounds(state.valid)
    if state.single:
        q, p = ([mean.mean for mean in means] for means in (state.modes_q, state.modes_p))
        q_bounds, p_bounds = ([state.bounds(m) for m in means] for means in (state.modes_q, state.modes_p))
        agreement = state.agreement
        delta = agreement.mean - sum(x * y for x, y in zip(q, p, strict=True))
        diversity_q, diversity_p = 1 - sum(x * x for x in q), 1 - sum(y * y for y in p)
        delta_range = effect_bounds(state.bounds(agreement), q_bounds, p_bounds)
        q_range, p_range = gini_bounds(q_bounds), gini_bounds(p_bounds)
        product, capacity_range = inf, (sqrt(q_range[0] * p_range[0]), sqrt(q_range[1] * p_range[1]))
    else:
        delta, diversity_q, diversity_p = (m.mean for m in (state.delta, state.diversity_q, state.diversity_p))
        delta_range = _inside(state.bounds(state.delta), -largest, largest)
        q_range, p_range = (_inside(state.bounds(m), 0.0, largest) for m in (state.diversity_q, state.diversity_p))
        product = state.product_high.mean
        capacity_range = _capacity_range(state, q_range, p_range)
    capacity = nan if isnan(diversity_q) else sqrt(min(product, diversity_q * diversity_p))
    rho_range = _rho_range(delta_range, capacity_range)
    verdict, site, reason = _verdict(state, rho_range, capacity_range, valid)
    ranges = {
        "delta": delta_range,
        "diversity_q": q_range,
        "diversity_p": p_range,
        "valid_rate": valid,
        "capacity": capacity_range,
        "rho": rho_range,
    }
    return CertificateReading(
        verdict=verdict,
        occupancy=site,
        reason=reason,
        kind="pooled" if state.single else "conditional",
        delta=delta,
        diversity_q=diversity_q,
        diversity_p=diversity_p,
        valid_rate=state.valid.mean,
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


def _inside(bounds: Range, low: float, high: float) -> Range:
    """Both bounds moved into what is possible at all, from whichever side they lie outside."""
    return min(high, max(low, bounds[0])), max(low, min(high, bounds[1]))


def _capacity_range(state: CertificateState, q: Range, p: Range) -> Range:
    """Bounds on the mean over decisions of C = sqrt(G(q) G(p)), where no diversity exceeds L = 1 - 1/K.

    From above sqrt(mean G(q) G(p)) (Jensen) and sqrt(mean G(q) * mean G(p)) (Cauchy-Schwarz). From below
    mean G(q) G(p) / L, since C <= L, and mean G(q) + mean G(p) - L, since (L - G(q)) (L - G(p)) >= 0.
    """
    largest = 1 - 1 / state.n_modes
    product = state.bounds(state.product_low)[0], state.bounds(state.product_high)[1]
    high = min(largest, sqrt(q[1] * p[1]), sqrt(product[1]))
    return min(high, max(0.0, product[0] / largest, q[0] + p[0] - largest)), high


def _rho_range(delta: Range, capacity: Range) -> Range:
    """Bounds on delta / C, which is never outside [-1, 1]."""

    def furthest(effect: float, divisor: float) -> float:
        return max(-1.0, min(1.0, effect / divisor)) if divisor > 0 else float((effect > 0) - (effect < 0))

    return (
        furthest(delta[0], capacity[1] if delta[0] > 0 else capacity[0]),
        furthest(delta[1], capacity[1] if delta[1] < 0 else capacity[0]),
    )


def _verdict(state: CertificateState, rho: Range, capacity: Range, valid: Range) -> tuple[str, Occupancy | None, str]:
    """The verdict that every point inside the bounds supports, its site, and what stands in a firmer one's way."""
    if valid[1] < state.min_valid_rate:
        return "low-validity", None, f"fewer than {state.min_valid_rate:.0%} of the pairs are valid in both heads"
    sites = sites_within(rho, capacity, state.n_modes, floor=state.margin, origin=state.collapse)
    # Pooled diversities are at least the decisions' own, so a pooled collapse is one; no more follows from them.
    if len({site.verdict for site in sites}) == 1 and (not state.single or Occupancy.ORIGIN in sites):
        site = next(iter(sites))
        return site.verdict, site if len(sites) == 1 else None, ""
    low, high = (bound / (1 - 1 / state.n_modes) for bound in capacity)
    if state.single:
        reason = (
            "single pairs show the pooled effect alone, which contains the conditions' own co-movement "
            "(Simpson term): give two pairs or more per decision"
        )
    elif Occupancy.ORIGIN in sites and 0 < state.tuned_pairs < PRODUCT_PAIRS:
        reason = (
            "fewer than four pairs per decision: the collapse of one head in every decision cannot be excluded "
            f"(relative capacity between {low:.2f} and {high:.2f})"
        )
    else:
        reason = (
            f"the bounds are too wide: rho between {rho[0]:+.3f} and {rho[1]:+.3f}, relative capacity between "
            f"{low:.2f} and {high:.2f}"
        )
    return "insufficient", None, reason
