"""Packs of gate files: the same gates, far fewer bytes, bounded and checked when read."""

import json
import lzma

import numpy as np
import pytest

from dualhead_eval.gate.file import gate_digest, write_gate
from dualhead_eval.gate.pack import GatePack, write_pack
from dualhead_eval.report.inputs import read_inputs

NAMES = [f"G-6k/seed-{seed}/006000-frozen" for seed in range(8)]


@pytest.fixture
def gates(make_gate):
    conditions = np.random.default_rng(0).normal(size=(40, 3)).round(4)
    found = {name: make_gate(name, couple=0.4, seed=seed, conditions=40) for seed, name in enumerate(NAMES)}
    for gate in found.values():
        gate.conditions[:] = conditions
    return found


@pytest.fixture
def pack(tmp_path, gates):
    return write_pack(tmp_path / "ring.gates.jsonl.xz", gates)


def rewritten(pack, change):
    lines = lzma.decompress(pack.read_bytes()).decode().splitlines()
    pack.write_bytes(lzma.compress("".join(f"{line}\n" for line in change(lines)).encode()))
    return pack


def test_a_pack_holds_its_gates_unchanged_in_any_order(tmp_path, pack, gates):
    opened = GatePack(pack)
    assert opened.names == tuple(NAMES)
    for name, gate in gates.items():
        assert gate_digest(opened.gate(name)) == gate_digest(gate)
    again = write_pack(tmp_path / "again.gates.jsonl.xz", dict(reversed(gates.items())))
    assert again.read_bytes() == pack.read_bytes()


def test_what_gates_repeat_takes_room_once(tmp_path, make_gate):
    gates = {name: make_gate(name, couple=0.4, conditions=40) for name in NAMES}  # they differ in their label alone
    files = [write_gate(gate, tmp_path / f"{i}.gate.json.gz") for i, gate in enumerate(gates.values())]
    pack = write_pack(tmp_path / "all.gates.jsonl.xz", gates)
    assert pack.stat().st_size < sum(file.stat().st_size for file in files) / 4


def test_a_report_reads_a_pack_or_a_folder_of_packs(tmp_path, pack):
    for path in (pack, tmp_path):
        assert [gate.label for gate in read_inputs([path]).gates] == NAMES
        assert [gate.label for gate in read_inputs([path], "G-6k/seed-[12]/*").gates] == NAMES[1:3]
        with pytest.raises(ValueError, match=r"no gate like 'H-6k', .* names like 'G-6k/seed-0/006000-frozen'"):
            read_inputs([path], "H-6k")


@pytest.mark.parametrize("name", ["../G", "/G", "G/../../H", "", "G//H", "G\n", "a/" * 9 + "b", "x" * 300])
def test_a_name_leads_down_and_nowhere_else(tmp_path, make_gate, pack, name):
    with pytest.raises(ValueError, match="names"):
        write_pack(tmp_path / "x.gates.jsonl.xz", {name: make_gate()})
    header = json.dumps({"format": "dualhead-gates/1", "names": [name]})
    with pytest.raises(ValueError, match="names"):
        GatePack(rewritten(pack, lambda lines: [header, lines[1]]))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda lines: lines[1:], "line 1 of"),
        (lambda lines: lines[:-1], "names 8 gates and holds 7"),
        (lambda lines: [*lines, lines[-1]], "names 8 gates and holds 9"),
        (lambda lines: [lines[0].replace("seed-1", "seed-0"), *lines[1:]], "names 7 gates and holds 8"),
        (lambda lines: [lines[0].replace("gates/1", "gates/2"), *lines[1:]], "has format 'dualhead-gates/2'"),
        (lambda lines: [], "line 1 of"),
    ],
)
def test_what_is_not_whole_is_refused(pack, change, words):
    with pytest.raises(ValueError, match=words):
        GatePack(rewritten(pack, change))


def test_an_edited_gate_is_refused_by_its_name_and_the_others_are_read(pack):
    GatePack(rewritten(pack, lambda lines: [line.replace('"n_modes":2', '"n_modes":3') if i == 3 else line
                                            for i, line in enumerate(lines)]))  # fmt: skip
    opened = GatePack(pack)
    with pytest.raises(ValueError, match=rf"ring\.gates\.jsonl\.xz/{NAMES[2]} was changed after it was written"):
        opened.gate(NAMES[2])
    assert opened.gate(NAMES[3]).label == NAMES[3]


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.9, 0.999])
def test_a_torn_pack_is_refused(pack, share):
    whole = pack.read_bytes()
    pack.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ValueError, match=r"ring\.gates\.jsonl\.xz is truncated or"):
        GatePack(pack)


def test_a_flipped_byte_is_refused(pack):
    whole = pack.read_bytes()
    rng = np.random.default_rng(0)
    for position in rng.integers(0, len(whole), 60):
        changed = bytearray(whole)
        changed[position] ^= 1 << int(rng.integers(8))
        pack.write_bytes(changed)
        with pytest.raises(ValueError, match=r"ring\.gates\.jsonl\.xz"):
            GatePack(pack)


def test_bytes_behind_the_end_are_refused(pack):
    pack.write_bytes(pack.read_bytes() + b"more")
    with pytest.raises(ValueError, match="has bytes behind its end"):
        GatePack(pack)


def test_a_bomb_is_not_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr("dualhead_eval.gate.pack.MAX_TEXT", 2**20)
    path = tmp_path / "bomb.gates.jsonl.xz"
    path.write_bytes(lzma.compress(b" " * 2**24))
    with pytest.raises(ValueError, match="unpacks to more than"):
        GatePack(path)


def test_a_pack_that_is_not_there_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.gates\.jsonl\.xz does not exist"):
        GatePack(tmp_path / "none.gates.jsonl.xz")
