"""What a coordination certificate remembers: a few running sums, mergeable and storable as JSON."""

from __future__ import annotations

import json
import math
import os
import uuid
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from dualhead_eval.atomic_text import write_text
from dualhead_eval.statistics.confidence_sequence import RunningMean, tuned_variance

#: Format written and read by this version.
FORMAT = "dualhead-certificate/2"
#: Running means of single quantities.
MEANS = ("valid", "delta", "diversity_q", "diversity_p", "product_low", "product_high", "agreement")


@dataclass
class CertificateState:
    """Parameters and running sums.

    Attributes:
        n_modes, alpha, margin, collapse, min_valid_rate: See ``CoordinationCertificate``.
        single: Whether the stream holds one pair a decision.
        tuned_pairs: Pairs per decision for which the bounds are tightest: those of the first decision, 0 before.
        decisions, pairs, valid_pairs, agreeing: Totals.
        valid: Valid share per decision.
        delta, diversity_q, diversity_p: Unbiased estimates per decision with two both-valid pairs or more.
        product_low, product_high: Estimates of G(q) G(p) per such decision, from four both-valid pairs or more;
            below four, 0 and (1 - 1/K) (G(q) + G(p)) / 2, whose means are never above and never below it.
        agreement: Agreement of single both-valid pairs.
        modes_q, modes_p: Frequency of each mode among single both-valid pairs.
        streams: Identities of the streams counted here, so that none is counted twice.
    """

    n_modes: int
    alpha: float
    margin: float
    collapse: float
    min_valid_rate: float
    single: bool
    tuned_pairs: int
    decisions: int
    pairs: int
    valid_pairs: int
    agreeing: int
    valid: RunningMean
    delta: RunningMean
    diversity_q: RunningMean
    diversity_p: RunningMean
    product_low: RunningMean
    product_high: RunningMean
    agreement: RunningMean
    modes_q: list[RunningMean]
    modes_p: list[RunningMean]
    streams: list[str] = field(default_factory=lambda: [uuid.uuid4().hex])

    @property
    def n_sequences(self) -> int:
        """Sequences that share alpha: five (the two of the product are bounded on one side each), or validity,
        agreement and 2K frequencies of single pairs."""
        return 2 + 2 * self.n_modes if self.single else 5

    def bounds(self, mean: RunningMean) -> tuple[float, float]:
        """Bounds on one of the means, joint with those on the others."""
        return mean.bounds(self.alpha / self.n_sequences, tuned_variance(self.tuned_pairs))

    def merge(self, other: CertificateState) -> None:
        """Add another stream.

        Raises:
            ValueError: If parameters or kinds of stream differ, or if both count one stream.
        """
        if set(self.streams) & set(other.streams):
            raise ValueError(
                "both certificates have counted one stream (one is a copy of the other, or itself), expected "
                "streams of their own: merging would count its decisions twice"
            )
        parameters = ("n_modes", "alpha", "margin", "collapse", "min_valid_rate")
        for name in parameters:
            mine, theirs = getattr(self, name), getattr(other, name)
            if mine != theirs:
                raise ValueError(
                    f"certificates with {name}={mine} and {theirs} given, expected the same: merge like with like"
                )
        if self.decisions and other.decisions and self.single != other.single:
            raise ValueError("certificates of single pairs and of several pairs a decision given, expected one kind")
        self.single = other.single if other.decisions else self.single
        self.tuned_pairs = max(self.tuned_pairs, other.tuned_pairs)
        self.streams = [*self.streams, *other.streams]
        for name in ("decisions", "pairs", "valid_pairs", "agreeing"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for name in MEANS:
            getattr(self, name).merge(getattr(other, name))
        for name in ("modes_q", "modes_p"):
            for mine, theirs in zip(getattr(self, name), getattr(other, name), strict=True):
                mine.merge(theirs)


def new_state(n_modes: int, alpha: float, margin: float, collapse: float, min_valid_rate: float) -> CertificateState:
    """An empty state.

    Raises:
        ValueError: If a parameter is out of range.
    """
    if int(n_modes) != n_modes or n_modes < 2:
        raise ValueError(f"n_modes={n_modes}, expected an integer of at least 2: one mode cannot be coordinated")
    for name, value in (("alpha", alpha), ("margin", margin), ("collapse", collapse)):
        if not 0 < value < 1:
            raise ValueError(f"{name}={value}, expected a number between 0 and 1")
    if not 0 <= min_valid_rate <= 1:
        raise ValueError(f"min_valid_rate={min_valid_rate}, expected a number from 0 to 1")
    return CertificateState(
        n_modes=int(n_modes),
        alpha=float(alpha),
        margin=float(margin),
        collapse=float(collapse),
        min_valid_rate=float(min_valid_rate),
        single=False,
        tuned_pairs=0,
        decisions=0,
        pairs=0,
        valid_pairs=0,
        agreeing=0,
        valid=RunningMean(0, 1),
        delta=RunningMean(-1, 1),
        diversity_q=RunningMean(0, 1),
        diversity_p=RunningMean(0, 1),
        product_low=RunningMean(0, 1),
        product_high=RunningMean(0, 1),
        agreement=RunningMean(0, 1),
        modes_q=[RunningMean(0, 1) for _ in range(int(n_modes))],
        modes_p=[RunningMean(0, 1) for _ in range(int(n_modes))],
    )


def write_state(state: CertificateState, path: str | os.PathLike) -> None:
    """Write ``state`` as JSON, atomically."""
    write_text(Path(path), json.dumps(state_document(state), indent=1, allow_nan=False))


def read_state(path: str | os.PathLike) -> CertificateState:
    """Read a state.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is truncated or not a certificate of this version.
    """
    source = Path(path)
    if not source.is_file():
        raise FileNotFoundError(f"certificate {source} does not exist: save one with CoordinationCertificate.save")
    try:
        document = json.loads(source.read_text())
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{source} is not a complete certificate (truncated, or not JSON): save it again") from error
    return state_of(document, str(source))


def state_document(state: CertificateState) -> dict[str, Any]:
    """``state`` as a JSON object."""
    return {"format": FORMAT, "state": asdict(state)}


def state_of(document: Any, source: str) -> CertificateState:
    """The state in a JSON object that :func:`state_document` made.

    Args:
        document: The object.
        source: Where it was read, for errors.

    Raises:
        ValueError: If it is not a certificate of this version, or holds what none can.
    """
    found = document.get("format") if isinstance(document, dict) else None
    if found != FORMAT:
        raise ValueError(f"{source} has format {found!r}, expected {FORMAT!r}: save it again with this version")
    try:
        stored = document["state"]
        values = {field.name: stored[field.name] for field in fields(CertificateState)}
        for name in MEANS:
            values[name] = _mean_of(values[name])
        for name in ("modes_q", "modes_p"):
            values[name] = [_mean_of(mean) for mean in values[name]]
        for name in ("tuned_pairs", "decisions", "pairs", "valid_pairs", "agreeing"):
            if type(values[name]) is not int or values[name] < 0:
                raise ValueError(f"{name} is no count")
        state = CertificateState(**values)
        new_state(state.n_modes, state.alpha, state.margin, state.collapse, state.min_valid_rate)
        if len(state.modes_q) != state.n_modes or len(state.modes_p) != state.n_modes:
            raise ValueError("mode frequencies do not match n_modes")
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{source} holds an inconsistent certificate ({error}): save it again") from error
    return state


def _mean_of(stored: Any) -> RunningMean:
    mean = RunningMean(**stored)
    numbers = (mean.low, mean.high, mean.count, mean.total, mean.variance)
    if not all(type(number) in (int, float) and math.isfinite(number) for number in numbers) or mean.count < 0:
        raise ValueError("a running mean is no number")
    return mean
