"""The gate file: one JSON document, written in one step and checked when it is read.

    {"format": "dualhead-gate/1", "sha256": <digest of content>, "content": {...}}

A name that ends in ``.gz`` makes it a gzip file of that document.

A truncated, foreign, edited or newer file is refused in a sentence.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.atomic_text import write_bytes
from dualhead_eval.gate.compressed import compress, decompress, is_compressed
from dualhead_eval.gate.gate import Gate
from dualhead_eval.residuals.strata import ResidualStrata

if TYPE_CHECKING:
    from dualhead_eval.gate.schema import Counts, GateContent, Numbers

#: Format written and read by this version.
FORMAT = "dualhead-gate/1"
REMEDY = "write it again with `dualhead evaluate`"


def write_gate(gate: Gate, path: str | os.PathLike, *, overwrite: bool = False) -> Path:
    """Write ``gate`` to ``path`` atomically and return the path.

    Raises:
        FileExistsError: If the file exists and ``overwrite`` is false.
        ValueError: If the provenance is not JSON (NaN included), or the label or a head is not a line of text.
    """
    target = Path(path)
    if target.exists() and not overwrite:
        raise FileExistsError(f"gate file {target} exists: choose another name or ask to overwrite it")
    document = document_of(gate) + "\n"
    write_bytes(target, compress(document) if is_compressed(target) else document.encode())
    return target


def document_of(gate: Gate) -> str:
    """The document of a gate file, one line without its end.

    Raises:
        ValueError: As :func:`write_gate`.
    """
    _check_names(gate)
    try:
        content = _canonical(_to_content(gate))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"provenance of gate {gate.label!r} is not plain JSON ({error}): store numbers, strings, lists and "
            "objects, and None instead of NaN"
        ) from error
    digest = hashlib.sha256(content.encode()).hexdigest()
    return f'{{"format": "{FORMAT}", "sha256": "{digest}", "content": {content}}}'


def read_gate(path: str | os.PathLike) -> Gate:
    """Read and verify a gate file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is truncated, not a gate file, of another version, or was edited.
    """
    source = Path(path)
    if not source.is_file():
        raise FileNotFoundError(f"gate file {source} does not exist: write one with `dualhead evaluate`")
    return verified_gate(_read_document(source), str(source))


def verified_gate(document: Any, source: str, remedy: str = REMEDY) -> Gate:
    """The gate in the document of a gate file.

    Args:
        document: The document, parsed.
        source: Where it was read, for the errors.
        remedy: What to do about a wrong one.

    Raises:
        ValueError: As :func:`read_gate`.
    """
    # The schema's package registers environments; importing this module stays light.
    from dualhead_envs.validated_json import shown, validated
    from dualhead_eval.gate.schema import GateContent

    if not isinstance(document, dict) or "format" not in document:
        raise ValueError(f"{source} is JSON but not a gate file (no format field): {remedy}")
    if document["format"] != FORMAT:
        raise ValueError(f"{source} has format {shown(document['format'])}, expected {FORMAT!r}: {remedy}")
    content = document.get("content")
    if not isinstance(content, dict) or "sha256" not in document:
        raise ValueError(f"{source} lacks its content or checksum, expected both: {remedy}")
    try:
        digest = hashlib.sha256(_canonical(content).encode()).hexdigest()
    except ValueError:
        # A number too large for JSON, which no gate file of ours contains.
        digest = ""
    if digest != document["sha256"]:
        raise ValueError(f"{source} was changed after it was written (its checksum differs): {remedy}")
    packed = validated(content, GateContent, source=f"{source} holds an inconsistent gate: it", remedy=remedy)
    try:
        gate = _gate_of(packed)
        _check_names(gate)
        return gate
    except (OverflowError, ValueError) as error:
        raise ValueError(f"{source} holds an inconsistent gate ({error}): {remedy}") from error


def _read_document(source: Path) -> Any:
    """The JSON document in a gate file, compressed or not."""
    from dualhead_envs.validated_json import parse_json, read_json

    kind = "a gate file"
    if not is_compressed(source):
        return read_json(source, kind=kind, remedy=REMEDY)
    return parse_json(decompress(source, kind=kind, remedy=REMEDY), source=str(source), kind=kind, remedy=REMEDY)


def _check_names(gate: Gate) -> None:
    """Refuse labels and heads that could steer the terminal on which they are printed."""
    from dualhead_envs.validated_json import LONGEST_LABEL, shown

    for what, name in [*(("head", head) for head in gate.heads), ("label", gate.label)]:
        if not 1 <= len(name) <= LONGEST_LABEL or not name.isprintable():
            raise ValueError(
                f"gate has a {what} {shown(name)}, expected 1 to {LONGEST_LABEL} characters of printable text: choose "
                "another"
            )


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


def _unpack(packed: Counts | Numbers, dtype: type) -> NDArray:
    if math.prod(packed.shape) != len(packed.values):
        raise ValueError(f"an array of shape {packed.shape} holds {len(packed.values)} values")
    values = [np.nan if value is None else value for value in packed.values]
    return np.array(values, dtype=dtype).reshape(packed.shape)


_STRATA_FIELDS = ("n", "total", "squares", "median", "u")


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
            name: {"unit": strata.unit} | {key: _pack(getattr(strata, key)) for key in _STRATA_FIELDS}
            for name, strata in gate.strata.items()
        },
    }


def _gate_of(content: GateContent) -> Gate:
    target = content.target_probabilities
    return Gate(
        heads=tuple(content.heads),
        n_modes=content.n_modes,
        taus=content.taus,
        nfes=content.nfes,
        reference_tau=content.reference_tau,
        reference_nfe=content.reference_nfe,
        counts=_unpack(content.counts, np.int64),
        conditions=_unpack(content.conditions, np.float64),
        pair_ids=_unpack(content.pair_ids, np.int64),
        target_probabilities=None if target is None else np.array(target, dtype=np.float64),
        provenance=content.provenance,
        strata={
            name: ResidualStrata(
                unit=packed.unit,
                **{
                    field: _unpack(getattr(packed, field), np.int64 if field == "n" else np.float64)
                    for field in _STRATA_FIELDS
                },
            )
            for name, packed in content.strata.items()
        },
    )
