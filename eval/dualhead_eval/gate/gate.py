"""The gate: the frozen product of one evaluation, from which every number of a report is recomputable.

A gate holds joint tables of mode labels per condition, threshold (tau) and number of integration steps (NFE),
invalid samples included, with everything needed to know where they came from.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.effects.counts import pair_counts
from dualhead_eval.gate.consistency import check_provenance, check_strata, check_thresholds
from dualhead_eval.residuals.strata import ResidualStrata

#: ``provenance["method"]`` of a gate whose conditions are the decisions of recorded rollouts.
ROLLOUTS = "recorded rollouts"
#: The same of a gate that was counted from a table of labels: its threshold 0 and its step 1 stand for labels as given.
LABEL_TABLE = "label table"
#: The same of two draws of one policy, and of one draw of each of two.
DRAWS, POLICY_PAIR = "draws of one policy", "two policies"


@dataclass(frozen=True, eq=False)
class Gate:
    """Counts of one evaluated run and their provenance.

    Attributes:
        heads: Names of the heads (or ensemble members), for example ``("joint", "position")``.
        n_modes: Number of modes K of the partition.
        taus: Thresholds scanned, increasing.
        nfes: Integration steps scanned, increasing.
        reference_tau: The threshold that headline numbers use, one of ``taus``.
        reference_nfe: The integration steps that headline numbers use, one of ``nfes``.
        counts: Joint counts, int64 ``(n_nfe, n_tau, n_conditions, K+1, ..., K+1)`` with one trailing axis a
            head; index K counts invalid samples.
        conditions: Environment state of each condition, ``(n_conditions, C)``.
        pair_ids: Id of each condition's demonstration pair, ``(n_conditions,)``; decisions of one recorded
            episode share theirs and are resampled together.
        target_probabilities: Mode frequencies of the data ``(K,)``, or None if unknown.
        provenance: JSON object: ``label`` of the run, ``partition``, seeds, versions, sampling, losses, ...
        strata: Residual strata by component name, each with leading shape ``(n_nfe, n_tau, n_conditions)``.
    """

    heads: tuple[str, ...]
    n_modes: int
    taus: list[float]
    nfes: list[int]
    reference_tau: float
    reference_nfe: int
    counts: NDArray[np.int64]
    conditions: NDArray[np.float64]
    pair_ids: NDArray[np.int64]
    target_probabilities: NDArray[np.float64] | None = None
    provenance: dict[str, Any] = field(default_factory=dict)
    strata: dict[str, ResidualStrata] = field(default_factory=dict)

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "heads", tuple(str(head) for head in self.heads))
        set_(self, "n_modes", int(self.n_modes))
        set_(self, "taus", [float(tau) for tau in self.taus])
        set_(self, "nfes", [int(nfe) for nfe in self.nfes])
        set_(self, "reference_tau", float(self.reference_tau))
        set_(self, "reference_nfe", int(self.reference_nfe))
        counts = np.asarray(self.counts)
        if counts.dtype.kind not in "iu":
            raise ValueError(f"gate counts have dtype {counts.dtype}, expected integers: count label pairs")
        set_(self, "counts", counts.astype(np.int64))
        set_(self, "conditions", np.asarray(self.conditions, dtype=np.float64))
        set_(self, "pair_ids", np.asarray(self.pair_ids, dtype=np.int64))
        if self.target_probabilities is not None:
            set_(self, "target_probabilities", np.asarray(self.target_probabilities, dtype=np.float64))
        _validate(self)
        check_thresholds(self.counts, len(self.heads))
        check_provenance(self.provenance, self.n_modes, self.reference_tau, self.counts)
        check_strata(self.strata, self.counts, self.heads)
        _check_rows(self)

    @property
    def label(self) -> str:
        """Name of the run, as given in the provenance."""
        return str(self.provenance.get("label", "unnamed run"))

    @property
    def partition(self) -> dict[str, Any]:
        """The mode partition that labelled the samples (name, n_modes, tau and parameters)."""
        return dict(self.provenance.get("partition", {}))

    @property
    def n_conditions(self) -> int:
        """Number of conditions evaluated."""
        return int(self.counts.shape[2])

    def index(self, tau: float | None = None, nfe: int | None = None) -> tuple[int, int]:
        """Position of an operating point on the first two axes; the reference point by default.

        Raises:
            KeyError: If the threshold or the number of steps was not scanned.
        """
        tau = self.reference_tau if tau is None else float(tau)
        nfe = self.reference_nfe if nfe is None else int(nfe)
        if nfe not in self.nfes:
            raise KeyError(f"nfe={nfe} was not evaluated, only {self.nfes}: choose one of these or evaluate again")
        if tau not in self.taus:
            raise KeyError(f"tau={tau} was not evaluated, only {self.taus}: choose one of these or evaluate again")
        return self.nfes.index(nfe), self.taus.index(tau)

    def table(self, tau: float | None = None, nfe: int | None = None) -> NDArray[np.int64]:
        """Joint counts of all heads at one operating point, ``(n_conditions, K+1, ..., K+1)``."""
        return self.counts[self.index(tau, nfe)]

    def pair_table(
        self, first: int = 0, second: int = 1, *, tau: float | None = None, nfe: int | None = None
    ) -> NDArray[np.int64]:
        """Counts of two heads at one operating point, ``(n_conditions, K+1, K+1)``."""
        return pair_counts(self.table(tau, nfe), len(self.heads), first, second)


def _check_rows(gate: Gate) -> None:
    """Refuse a condition counted twice; decisions of a recorded episode may share pair and state."""
    if gate.provenance.get("method") == ROLLOUTS:
        return
    rows = np.column_stack([gate.pair_ids, gate.conditions])
    if len(np.unique(rows, axis=0)) < len(rows):
        raise ValueError("gate conditions hold the same pair and state twice, expected each once: evaluate again")


def _validate(gate: Gate) -> None:
    side = gate.n_modes + 1
    leading = (len(gate.nfes), len(gate.taus), gate.counts.shape[2] if gate.counts.ndim > 2 else 0)
    expected = leading + (side,) * len(gate.heads)
    if gate.n_modes < 2:
        raise ValueError(f"gate has n_modes={gate.n_modes}, expected at least 2")
    if len(gate.heads) < 2 or len(set(gate.heads)) != len(gate.heads):
        raise ValueError(f"gate has heads {gate.heads}, expected two or more different names")
    for name, values, least in (("taus", gate.taus, 0), ("nfes", gate.nfes, 1)):
        if not values or sorted(set(values)) != values or not least <= values[0] <= values[-1] < float("inf"):
            raise ValueError(f"gate has {name}={values}, expected one or more increasing numbers from {least}")
    if gate.counts.shape != expected or gate.n_conditions == 0:
        raise ValueError(
            f"gate counts have shape {gate.counts.shape}, expected (n_nfe={len(gate.nfes)}, n_tau={len(gate.taus)}, "
            f"n_conditions) + {len(gate.heads)} axes of K+1={side}"
        )
    if (gate.counts < 0).any():
        raise ValueError("gate counts contain a negative number, expected counts of sample pairs")
    sampled = gate.counts.sum(axis=tuple(range(3, gate.counts.ndim)))
    if (sampled != sampled[:, :1]).any():
        raise ValueError(
            "gate counts hold different numbers of samples at different thresholds, expected one set of samples "
            "labelled again at each: evaluate again"
        )
    if gate.reference_tau not in gate.taus or gate.reference_nfe not in gate.nfes:
        raise ValueError(
            f"gate's reference tau={gate.reference_tau}, nfe={gate.reference_nfe} are not among {gate.taus} and "
            f"{gate.nfes}"
        )
    if gate.conditions.ndim != 2 or len(gate.conditions) != gate.n_conditions:
        raise ValueError(
            f"gate conditions have shape {gate.conditions.shape}, expected ({gate.n_conditions}, C): one row each"
        )
    if not np.isfinite(gate.conditions).all():
        raise ValueError("gate conditions contain NaN or infinity, expected the environment's state")
    if gate.pair_ids.shape != (gate.n_conditions,) or (gate.pair_ids < 0).any():
        raise ValueError(
            f"gate pair_ids have shape {gate.pair_ids.shape}, expected ({gate.n_conditions},) and no negative ones"
        )
    target = gate.target_probabilities
    if target is not None and (
        target.shape != (gate.n_modes,) or not (target >= 0).all() or abs(target.sum() - 1) > 1e-6
    ):
        raise ValueError(
            f"gate target_probabilities are {target.tolist()}, expected {gate.n_modes} numbers >= 0 that sum to 1"
        )
    if not isinstance(gate.provenance, dict):
        raise ValueError(f"gate provenance is a {type(gate.provenance).__name__}, expected a JSON object")
    for name, strata in gate.strata.items():
        if strata.u.shape != leading:
            raise ValueError(f"gate strata {name!r} have leading shape {strata.u.shape}, expected {leading}")
