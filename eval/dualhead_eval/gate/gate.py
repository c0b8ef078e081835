"""The gate file: the frozen product of one evaluation, from which every number of a report is recomputable.

A gate holds joint tables of mode labels per condition, threshold (tau) and number of integration steps (NFE),
invalid samples included, with everything needed to know where they came from. On disk it is one JSON document

    {"format": "dualhead-gate/1", "sha256": <digest of content>, "content": {...}}

written atomically and checked on reading: a truncated, foreign, edited or newer file is refused in a sentence.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.atomic_text import write_text
from dualhead_eval.effects.counts import pair_counts
from dualhead_eval.residuals.strata import ResidualStrata

#: Format written and read by this version.
FORMAT = "dualhead-gate/1"


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


def _validate(gate: Gate) -> None:
    side = gate.n_modes + 1
    leading = (len(gate.nfes), len(gate.taus), gate.counts.shape[2] if gate.counts.ndim > 2 else 0)
    expected = leading + (side,) * len(gate.heads)
    if gate.n_modes < 2:
        raise ValueError(f"gate has n_modes={gate.n_modes}, expected at least 2")
    if len(gate.heads) < 2 or len(set(gate.heads)) != len(gate.heads):
        raise ValueError(f"gate has heads {gate.heads}, expected two or more different names")
    for name, values in (("taus", gate.taus), ("nfes", gate.nfes)):
        if not values or sorted(set(values)) != values:
            raise ValueError(f"gate has {name}={values}, expected one or more increasing numbers")
    if gate.counts.shape != expected or gate.n_conditions == 0:
        raise ValueError(
            f"gate counts have shape {gate.counts.shape}, expected (n_nfe={len(gate.nfes)}, "
            f"n_tau={len(gate.taus)}, "
            f"n_conditions) + {len(gate.heads)} axes of K+1={side}"
        )
    if (gate.counts < 0).any():
        raise ValueError("gate counts contain a negative number, expected counts of sample pairs")
    sampled = gate.counts.sum(axis=tuple(range(3, gate.counts.ndim)))
    if (sampled != sampled[:, :1]).any():
        raise ValueError(
            "gate counts hold different numbers of samples at different thresholds, expected one set of "
            "samples "
            "labelled again at each: evaluate again"
        )
    if gate.reference_tau not in gate.taus or gate.reference_nfe not in gate.nfes:
        raise ValueError(
            f"gate's reference tau={gate.reference_tau}, nfe={gate.reference_nfe} are not among {gate.taus} "
            f"and "
            f"{gate.nfes}"
        )
    if gate.conditions.ndim != 2 or len(gate.conditions) != gate.n_conditions:
        raise ValueError(
            f"gate conditions have shape {gate.conditions.shape}, expected ({gate.n_conditions}, C): one row each"
        )
    if not np.isfinite(gate.conditions).all():
        raise ValueError("gate conditions contain NaN or infinity, expected the environment's state")
    if gate.pair_ids.shape != (gate.n_conditions,):
        raise ValueError(f"gate pair_ids have shape {gate.pair_ids.shape}, expected ({gate.n_conditions},)")
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


def write_gate(gate: Gate, path: str | os.PathLike, *, overwrite: bool = False) -> Path:
    """Write ``gate`` to ``path`` atomically and return the path.

    Raises:
        FileExistsError: If the file exists and ``overwrite`` is false.
        ValueError: If the provenance is not JSON (NaN included).
    """
    target = Path(path)
    if target.exists() and not overwrite:
        raise FileExistsError(f"gate file {target} exists: choose another name or ask to overwrite it")
    try:
        content = _canonical(_to_content(gate))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"provenance of gate {gate.label!r} is not plain JSON ({error}): store numbers, strings, lists "
            f"and "
            "objects, and None instead of NaN"
        ) from error
    digest = hashlib.sha256(content.encode()).hexdigest()
    write_text(target, f'{{"format": "{FORMAT}", "sha256": "{digest}", "content": {content}}}\n')
    return target


def read_gate(path: str | os.PathLike) -> Gate:
    """Read and verify a gate file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is truncated, not a gate file, of another version, or was edited.
    """
    source = Path(path)
    if not source.is_file():
        raise FileNotFoundError(f"gate file {source} does not exist: write one with `dualhead evaluate`")
    again = "write it again with `dualhead evaluate`"
    try:
        document = json.loads(source.read_text())
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"{source} is not a complete gate file (truncated, or not JSON at all): {again}") from error
    if not isinstance(document, dict) or "format" not in document:
        raise ValueError(f"{source} is JSON but not a gate file (no format field): {again}")
    if document["format"] != FORMAT:
        raise ValueError(f"{source} has format {document['format']!r}, expected {FORMAT!r}: {again}")
    content = document.get("content")
    if not isinstance(content, dict) or "sha256" not in document:
        raise ValueError(f"{source} lacks its content or checksum, expected both: {again}")
    try:
        digest = hashlib.sha256(_canonical(content).encode()).hexdigest()
    except ValueError:
        # NaN or infinity, which no gate file of ours contains.
        digest = ""
    if digest != document["sha256"]:
        raise ValueError(f"{source} was changed after it was written (its checksum differs): {again}")
    try:
        return _from_content(content)
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise ValueError(f"{source} holds an inconsistent gate ({error}): {again}") from error


def gate_digest(gate: Gate) -> str:
    """The sha256 that identifies a gate's content, as stored in its file."""
    return hashlib.sha256(_canonical(_to_content(gate)).encode()).hexdigest()


def _canonical(content: Mapping[str, Any]) -> str:
    text = json.dumps(content, separators=(",", ":"), allow_nan=False, default=_plain)
    # Through JSON and back first: keys become strings, and only then have one sorted order.
    return json.dumps(json.loads(text), sort_keys=True, separators=(",", ":"), allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"{type(value).__name__} has no JSON form")


def _pack(array: NDArray) -> dict[str, Any]:
    flat = array.ravel().tolist()
    if array.dtype.kind == "f":
        flat = [None if value != value else value for value in flat]
    return {"shape": list(array.shape), "values": flat}


def _unpack(packed: Mapping[str, Any], dtype: type) -> NDArray:
    values = packed["values"]
    if dtype is np.float64:
        values = [np.nan if value is None else value for value in values]
    elif not all(type(value) is int for value in values):
        raise ValueError("an array of counts holds something other than integers")
    return np.array(values, dtype=dtype).reshape(packed["shape"])


_STRATA_FIELDS = (
    ("n", np.int64),
    ("total", np.float64),
    ("squares", np.float64),
    ("median", np.float64),
    ("u", np.float64),
)


def _to_content(gate: Gate) -> dict[str, Any]:
    target = gate.target_probabilities
    return {
        "heads": list(gate.heads),
        "n_modes": gate.n_modes,
        "taus": gate.taus,
        "nfes": gate.nfes,
        "reference_tau": gate.reference_tau,
        "reference_nfe": gate.reference_nfe,
        "counts": _pack(gate.counts),
        "conditions": _pack(gate.conditions),
        "pair_ids": _pack(gate.pair_ids),
        "target_probabilities": None if target is None else target.tolist(),
        "provenance": gate.provenance,
        "strata": {
            name: {"unit": strata.unit} | {key: _pack(getattr(strata, key)) for key, _ in _STRATA_FIELDS}
            for name, strata in gate.strata.items()
        },
    }


def _from_content(content: Mapping[str, Any]) -> Gate:
    target = content["target_probabilities"]
    return Gate(
        heads=tuple(content["heads"]),
        n_modes=content["n_modes"],
        taus=content["taus"],
        nfes=content["nfes"],
        reference_tau=content["reference_tau"],
        reference_nfe=content["reference_nfe"],
        counts=_unpack(content["counts"], np.int64),
        conditions=_unpack(content["conditions"], np.float64),
        pair_ids=_unpack(content["pair_ids"], np.int64),
        target_probabilities=None if target is None else np.array(target, dtype=np.float64),
        provenance=content["provenance"],
        strata={
            name: ResidualStrata(unit=packed["unit"], **{k: _unpack(packed[k], t) for k, t in _STRATA_FIELDS})
            for name, packed in content["strata"].items()
        },
    )
