"""Inputs of a report: gate files, recorded datasets, rollouts, and folders of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

from dualhead_envs.recording.geometry_card import GeometryCard, read_geometry_card
from dualhead_eval.evaluation.rollouts import ROLLOUTS_SUFFIX, ROLLOUTS_SUFFIXES, ClosedLoop, read_closed_loop
from dualhead_eval.gate.file import read_gate
from dualhead_eval.gate.gate import Gate
from dualhead_eval.gate.pack import PACK_SUFFIX, GatePack
from dualhead_policy.training.sweep.manifest import MANIFEST_FILE, Manifest, read_manifest

#: How a gate file's name ends where folders are searched for them, plain or compressed.
GATE_SUFFIX = ".gate.json"
GATE_SUFFIXES = (GATE_SUFFIX, GATE_SUFFIX + ".gz")


@dataclass
class ReportInputs:
    """The inputs of a report, sorted by kind.

    Attributes:
        gates: Gates in the order given; those of a folder by name.
        cards: Geometry cards of recorded datasets, by folder.
        loops: Closed-loop outcomes by name.
        sweeps: Manifests of sweeps, by folder.
        from_folder: Whether a folder of results was among the inputs.
    """

    gates: list[Gate] = field(default_factory=list)
    cards: dict[Path, GeometryCard] = field(default_factory=dict)
    loops: list[tuple[str, ClosedLoop]] = field(default_factory=list)
    sweeps: dict[Path, Manifest] = field(default_factory=dict)
    from_folder: bool = False


def read_inputs(paths: Iterable[Path], only: str = "*") -> ReportInputs:
    """Read everything that a report is about.

    Args:
        paths: Gate files; packs of them (``*.gates.jsonl.xz``); ``*.rollouts.json`` files; folders of sweeps, of
            rollouts, of recorded datasets (with their ``card.json``), or of such files.
        only: Of the gates in packs, those whose names match this shell pattern (``*`` matches slashes, too).

    Raises:
        FileNotFoundError: If a path does not exist, or a folder holds nothing to report.
        ValueError: If a file is damaged or of another kind, or a pack has no gate of such a name.
    """
    inputs = ReportInputs()
    for path in paths:
        if not path.is_dir():
            _read_file(path, inputs, only)
        elif (path / "card.json").is_file():
            inputs.cards[path] = read_geometry_card(path / "card.json")
        elif (path / MANIFEST_FILE).is_file():
            _read_sweep(path, inputs, only)
        elif (path / "meta" / "dualhead.json").is_file():
            inputs.loops.append(read_closed_loop(path))
        else:
            found = _results(path.glob)
            if not found:
                raise FileNotFoundError(
                    f"{path} holds no *{GATE_SUFFIX}, no *{ROLLOUTS_SUFFIX} and no card.json: give gate files of "
                    "`dualhead evaluate`, a folder of them, or a dataset of `dualhead record`"
                )
            inputs.from_folder = True
            for file in found:
                _read_file(file, inputs, only)
    return inputs


def _read_sweep(path: Path, inputs: ReportInputs, only: str) -> None:
    """A sweep's folder: how far it is, and the gate files of its runs."""
    manifest = read_manifest(path)
    assert manifest is not None
    inputs.sweeps[path] = manifest.as_found(path)
    inputs.from_folder = True
    for file in _results(path.rglob):
        _read_file(file, inputs, only)


def _results(glob: Callable[[str], Iterable[Path]]) -> list[Path]:
    """Gate and rollout files that a folder's ``glob`` finds, by name."""
    return sorted(file for suffix in (*GATE_SUFFIXES, PACK_SUFFIX, *ROLLOUTS_SUFFIXES) for file in glob("*" + suffix))


def _read_file(path: Path, inputs: ReportInputs, only: str) -> None:
    if path.name.endswith(ROLLOUTS_SUFFIXES):
        inputs.loops.append(read_closed_loop(path))
    elif path.name.endswith(PACK_SUFFIX):
        pack = GatePack(path)
        names = [name for name in pack.names if fnmatchcase(name, only)]
        if pack.names and not names:
            raise ValueError(
                f"{path} has no gate like {only!r}, expected a pattern of names like {pack.names[0]!r}: "
                "give another --only, or none for all"
            )
        inputs.gates.extend(map(pack.gate, names))
    else:
        inputs.gates.append(read_gate(path))
