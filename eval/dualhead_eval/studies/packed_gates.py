"""The gate files of studies as one pack a dataset: what a repository keeps, a quarter of the files' bytes.

    v2/G_consistency_3-50k/seed-0/050000-frozen.gate.json.gz      a gate file
    v2.gates.jsonl.xz: G_consistency_3-50k/seed-0/050000-frozen   the same gate in its dataset's pack

A gate file counts before a packed gate of its name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from dualhead_envs.recording.claim import claimed, discard
from dualhead_eval.gate import Gate, read_gate, write_gate
from dualhead_eval.gate.file import gate_digest
from dualhead_eval.gate.pack import PACK_SUFFIX, GatePack, write_pack
from dualhead_eval.studies.study_plan import GATE_SUFFIX


class PackedGates:
    """The packs in a folder of gate files; each is read when one of its gates is first asked for."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._packs: dict[str, GatePack | None] = {}

    def pack(self, dataset: str) -> GatePack | None:
        """The pack of a dataset, None if there is none.

        Raises:
            ValueError: If it is damaged.
        """
        if dataset not in self._packs:
            path = pack_file(self.folder, dataset)
            self._packs[dataset] = GatePack(path) if path.is_file() else None
        return self._packs[dataset]

    @property
    def datasets(self) -> list[str]:
        """Datasets that have a pack."""
        return sorted(path.name.removesuffix(PACK_SUFFIX) for path in self.folder.glob("*" + PACK_SUFFIX))


def pack_file(folder: Path, dataset: str) -> Path:
    """Where the pack of a dataset lies."""
    return folder / f"{dataset}{PACK_SUFFIX}"


def packed_name(gate_file: Path) -> tuple[str, str]:
    """Dataset and name in its pack of a gate file, whose path is relative to the folder of gate files."""
    dataset, _, name = gate_file.as_posix().removesuffix(GATE_SUFFIX).partition("/")
    return dataset, name


def pack_gates(folder: Path, datasets: Iterable[str]) -> int:
    """Put the gate files of some datasets into their packs.

    A file is deleted when the pack that holds its gate is whole on the disk.

    Args:
        folder: Folder of gate files.
        datasets: The datasets.

    Returns:
        The number of gates that were files.

    Raises:
        BlockingIOError: If another process packs or unpacks the folder.
        ValueError: If a gate file or a pack is damaged, or a pack holds another gate of a file's name.
    """
    packed = 0
    with _alone(folder):
        for dataset in datasets:
            files = {packed_name(file.relative_to(folder))[1]: file for file in _gate_files(folder, dataset)}
            if not files:
                continue
            pack = PackedGates(folder).pack(dataset)
            gates: dict[str, Gate] = {name: pack.gate(name) for name in pack.names} if pack else {}
            for name, file in files.items():
                gate = read_gate(file)
                _refuse_two(file, gate, gates.get(name))
                gates[name] = gate
            write_pack(pack_file(folder, dataset), gates)
            for file in files.values():
                file.unlink()
                _remove_empty(file.parent, folder)
            packed += len(files)
    return packed


def unpack_gates(folder: Path, datasets: Iterable[str]) -> int:
    """Make gate files of the packs of some datasets; a pack is deleted when all of them are whole on the disk.

    Args:
        folder: Folder of gate files.
        datasets: The datasets.

    Returns:
        The number of gates that were packed.

    Raises:
        BlockingIOError: If another process packs or unpacks the folder.
        ValueError: If a pack is damaged, or holds another gate of a file's name.
    """
    unpacked = 0
    with _alone(folder):
        packs = PackedGates(folder)
        for dataset in datasets:
            if (pack := packs.pack(dataset)) is None:
                continue
            for name in pack.names:
                gate, file = pack.gate(name), folder / dataset / f"{name}{GATE_SUFFIX}"
                if file.is_file():
                    _refuse_two(file, read_gate(file), gate)
                else:
                    write_gate(gate, file)
            pack.path.unlink()
            unpacked += len(pack.names)
    return unpacked


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Nobody else packs or unpacks the folder: of two that do, one would lose the other's gates."""
    with claimed(folder / ".packing", folder) as claim:
        try:
            yield
        finally:
            discard(claim)


def _gate_files(folder: Path, dataset: str) -> list[Path]:
    return sorted((folder / dataset).rglob(f"*{GATE_SUFFIX}"))


def _refuse_two(file: Path, gate: Gate, packed: Gate | None) -> None:
    if packed is not None and gate_digest(gate) != gate_digest(packed):
        raise ValueError(
            f"{file} is another gate than that of its name in its dataset's pack, expected one of the two: move the "
            "file away, or delete it"
        )


def _remove_empty(folder: Path, root: Path) -> None:
    """Delete a folder and those above it as far as they are empty, ``root`` excepted."""
    while folder != root:
        try:
            folder.rmdir()
        except OSError:
            return
        folder = folder.parent
