"""A certificate that runs beside a robot: is zero mismatch coordination or collapse?

At deployment every decision is its own condition, so the protocol's many samples per condition are not to be
had. A few sample pairs per decision are enough: matched against mismatched pairs give an unbiased effect and
unbiased diversities per decision (:mod:`dualhead_eval.effects.unbiased`), their running means estimate the mean
conditional effect, and no pooling across conditions can fake coordination. The bounds hold jointly and at
every moment with probability 1 - alpha, without asymptotics, also when conditions drift or depend on earlier
actions. The words and thresholds are those of the report (:mod:`dualhead_eval.effects.sites`).

- Four pairs or more per decision bound the capacity from both sides, whichever head collapses where.
- Two or three bound it from below by mean G(q) + mean G(p) - (1 - 1/K): enough where both heads are diverse in
  most decisions; otherwise the collapse of one head cannot be excluded, and the reading says so.
- A single pair shows the pooled effect alone. It contains the Simpson term (rmk:simpson), the conditions' own
  co-movement, so such a stream is never called coordinated, anti-coordinated or uncoordinated; that it has
  collapsed or is rarely valid it does show.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dualhead_eval.certificate.reading import CertificateReading, read_certificate
from dualhead_eval.certificate.state import (
    new_state,
    read_state,
    state_document,
    state_of,
    write_state,
)
from dualhead_eval.effects.counts import INVALID, joint_table, validate_labels
from dualhead_eval.effects.sites import FLOOR_RHO, MIN_VALID_RATE, ORIGIN_CAPACITY
from dualhead_eval.effects.unbiased import PRODUCT_PAIRS, unbiased_coordination
from dualhead_eval.statistics.interval import Interval


class CoordinationCertificate:
    """Streaming coordination of two heads from their own labels, in bounded memory.

    >>> certificate = CoordinationCertificate(n_modes=2, alpha=0.05)
    >>> certificate.update([[0, 1, 1, 0]] * 4000, [[0, 1, 1, 0]] * 4000)  # four pairs a decision
    >>> certificate.verdict
    'coordinated'

    Args:
        n_modes: Number of modes K.
        alpha: Probability that any bound ever fails.
        margin: Band on rho: beyond it a stream counts as (anti-)coordinated, inside it as uncoordinated. The
            report's 2% by default; a wider band of your own is settled sooner and says less.
        collapse: Relative capacity C / (1 - 1/K) below which a stream counts as collapsed.
        min_valid_rate: Valid-pair rate below which a stream counts as low-validity.

    Raises:
        ValueError: If a parameter is out of range.
    """

    def __init__(
        self,
        n_modes: int = 2,
        alpha: float = 0.05,
        *,
        margin: float = FLOOR_RHO,
        collapse: float = ORIGIN_CAPACITY,
        min_valid_rate: float = MIN_VALID_RATE,
    ) -> None:
        self._state = new_state(n_modes, alpha, margin, collapse, min_valid_rate)
        self._cache: tuple[int, CertificateReading] | None = None

    def update(self, label_a: ArrayLike, label_b: ArrayLike) -> None:
        """Add decisions: labels ``(decisions, n)`` with n sample pairs each, or ``(n,)`` single pairs.

        Labels are modes 0..K-1, or -1 for an invalid sample. Pairs of one decision must be independent draws: a
        pair that follows a token or latent held from an earlier decision is not one, and is to be left out.

        Raises:
            ValueError: If shapes differ, a label is out of range, the update is empty, or single pairs and
                several pairs a decision are mixed in one certificate.
        """
        state = self._state
        a, b = validate_labels(label_a, state.n_modes), validate_labels(label_b, state.n_modes)
        if a.shape != b.shape or a.ndim not in (1, 2):
            raise ValueError(
                f"labels have shapes {a.shape} and {b.shape}, expected one shape: (n,) single pairs or (decisions, n)"
            )
        if a.size == 0:
            raise ValueError("labels are empty, expected at least one pair: call update once a decision was made")
        single = a.ndim == 1 or a.shape[1] == 1
        if state.decisions and single != state.single:
            seen, given = ("single pairs", "several") if state.single else ("several pairs a decision", "single")
            raise ValueError(
                f"this certificate has seen {seen} and now {given}, expected one kind: start a certificate for each"
            )
        state.single = single
        state.tuned_pairs = state.tuned_pairs or (1 if single else a.shape[1])
        if single and a.size == 1:
            self._add_single_pair(int(a.item()), int(b.item()))
        elif single:
            self._add_single_pairs(a.ravel(), b.ravel())
        elif len(a) == 1:
            self._add_decision(a[0].tolist(), b[0].tolist())
        else:
            self._add_decisions(a, b)

    def _add_decision(self, a: list[int], b: list[int]) -> None:
        """One decision without array overhead: what a control loop calls."""
        state, n_modes = self._state, self._state.n_modes
        rows, columns = [0] * n_modes, [0] * n_modes
        valid = agreeing = 0
        for k, m in zip(a, b, strict=True):
            if k >= 0 and m >= 0:
                valid += 1
                rows[k] += 1
                columns[m] += 1
                agreeing += k == m
        state.decisions += 1
        state.pairs += len(a)
        state.valid_pairs += valid
        state.agreeing += agreeing
        state.valid.add(valid / len(a))
        if valid < 2:
            return
        distinct = valid * (valid - 1)
        crossed = sum(r * s for r, s in zip(rows, columns, strict=True))
        diversity_q = (distinct - sum(r * (r - 1) for r in rows)) / distinct
        diversity_p = (distinct - sum(s * (s - 1) for s in columns)) / distinct
        state.delta.add((valid * agreeing - crossed) / distinct)
        state.diversity_q.add(diversity_q)
        state.diversity_p.add(diversity_p)
        if valid >= PRODUCT_PAIRS:
            product = _disjoint_product(a, b, rows, columns, valid)
            state.product_low.add(product)
            state.product_high.add(product)
        else:
            state.product_low.add(0.0)
            state.product_high.add(0.5 * (1 - 1 / n_modes) * (diversity_q + diversity_p))

    def _add_decisions(self, a: NDArray[np.int64], b: NDArray[np.int64]) -> None:
        state = self._state
        tables = joint_table([a, b], state.n_modes)[:, :-1, :-1]
        estimates = unbiased_coordination(tables)
        state.decisions += len(a)
        state.pairs += a.size
        state.valid_pairs += int(estimates.n.sum())
        state.agreeing += int(np.trace(tables, axis1=1, axis2=2).sum())
        state.valid.add_many(estimates.n / a.shape[1])
        used = estimates.n >= 2
        state.delta.add_many(estimates.delta[used])
        state.diversity_q.add_many(estimates.diversity_q[used])
        state.diversity_p.add_many(estimates.diversity_p[used])
        state.product_low.add_many(np.nan_to_num(estimates.product[used]))
        state.product_high.add_many(estimates.product_at_most[used])

    def _add_single_pair(self, k: int, m: int) -> None:
        """One pair without array overhead."""
        state = self._state
        both = k >= 0 and m >= 0
        state.decisions += 1
        state.pairs += 1
        state.valid.add(float(both))
        if both:
            state.valid_pairs += 1
            state.agreeing += k == m
            state.agreement.add(float(k == m))
            for mode in range(state.n_modes):
                state.modes_q[mode].add(float(k == mode))
                state.modes_p[mode].add(float(m == mode))

    def _add_single_pairs(self, a: NDArray[np.int64], b: NDArray[np.int64]) -> None:
        state = self._state
        both = (a != INVALID) & (b != INVALID)
        state.decisions += a.size
        state.pairs += a.size
        state.valid.add_many(both.astype(np.float64))
        a, b = a[both], b[both]
        agree = a == b
        state.valid_pairs += a.size
        state.agreeing += int(agree.sum())
        state.agreement.add_many(agree.astype(np.float64))
        for k in range(state.n_modes):
            state.modes_q[k].add_many((a == k).astype(np.float64))
            state.modes_p[k].add_many((b == k).astype(np.float64))

    @property
    def reading(self) -> CertificateReading:
        """Estimates, joint bounds and verdict now."""
        if self._cache is None or self._cache[0] != self._state.decisions:
            self._cache = (self._state.decisions, read_certificate(self._state))
        return self._cache[1]

    @property
    def verdict(self) -> str:
        """What the bounds support now; any verdict but ``insufficient`` is ever wrong with probability <= alpha."""
        return self.reading.verdict

    @property
    def n_modes(self) -> int:
        """Number of modes K."""
        return self._state.n_modes

    @property
    def delta(self) -> float:
        """Estimated effect: mean over decisions, or pooled for single pairs."""
        return self.reading.delta

    @property
    def capacity(self) -> float:
        """Estimated mean over decisions of sqrt(G_q G_p); errs upwards, with bounds from both sides."""
        return self.reading.capacity

    @property
    def rho(self) -> float:
        """delta / capacity, NaN without capacity; errs towards zero."""
        return self.reading.rho

    @property
    def valid_rate(self) -> float:
        """Mean over decisions of the share of sample pairs in which both heads are valid."""
        return self.reading.valid_rate

    @property
    def bounds(self) -> dict[str, Interval]:
        """Joint, time-uniform bounds on delta, diversity_q, diversity_p, valid_rate, and on capacity and rho."""
        return self.reading.bounds

    def merge(self, other: CoordinationCertificate) -> None:
        """Add what another process has seen; both certificates must have the same parameters.

        Raises:
            ValueError: If the parameters or the kind of stream differ, or if both have counted one stream.
        """
        self._state.merge(other._state)
        self._cache = None

    def save(self, path: str | os.PathLike) -> None:
        """Write the state to a JSON file, atomically (replacing an older state)."""
        write_state(self._state, path)

    @classmethod
    def load(cls, path: str | os.PathLike) -> CoordinationCertificate:
        """Continue from a saved state.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file is not a certificate.
        """
        certificate = cls.__new__(cls)
        certificate._state = read_state(path)
        certificate._cache = None
        return certificate

    def to_dict(self) -> dict[str, Any]:
        """The state as a JSON object, what :meth:`save` writes."""
        return state_document(self._state)

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> CoordinationCertificate:
        """Continue from a state that :meth:`to_dict` gave.

        Raises:
            ValueError: If it is not a certificate's.
        """
        certificate = cls.__new__(cls)
        certificate._state = state_of(document, "the state")
        certificate._cache = None
        return certificate

    def __repr__(self) -> str:
        r = self.reading
        word = r.occupancy.word if r.occupancy else r.verdict
        return (
            f"CoordinationCertificate({word}, {r.kind} delta={r.delta:+.4f}, capacity={r.capacity:.4f}, "
            f"valid_rate={r.valid_rate:.3f}, decisions={r.decisions})"
        )


def _disjoint_product(a: list[int], b: list[int], rows: list[int], columns: list[int], n: int) -> float:
    """Estimate of G(q) G(p) from the disjoint draws of one decision, as in ``unbiased_coordination``."""
    cells: dict[tuple[int, int], int] = {}
    for pair in zip(a, b, strict=True):
        if pair[0] >= 0 and pair[1] >= 0:
            cells[pair] = cells.get(pair, 0) + 1
    same_a, same_b = sum(r * r for r in rows), sum(s * s for s in columns)
    shared = sum(count * (n - rows[k]) * (n - columns[m]) for (k, m), count in cells.items())
    both = n * n - same_a - same_b + sum(count * count for count in cells.values())
    disjoint = (n * n - same_a) * (n * n - same_b) - 4 * shared + 2 * both
    return disjoint / (n * (n - 1) * (n - 2) * (n - 3))
