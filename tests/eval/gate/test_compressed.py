"""Compressed and compact gate files: the same gate, fewer bytes, bounded when read."""

import gzip
from dataclasses import replace

import numpy as np
import pytest

from dualhead_eval.effects.contingency import coordination
from dualhead_eval.effects.counts import both_valid
from dualhead_eval.gate import read_gate, write_gate
from dualhead_eval.gate.compact import compact_gate
from dualhead_eval.gate.compressed import MAX_DOCUMENT
from dualhead_eval.gate.file import gate_digest
from dualhead_eval.gate.merge import merge_gates
from dualhead_eval.report.inputs import read_inputs


def test_a_compressed_gate_is_the_same_gate_in_fewer_bytes(tmp_path, make_gate):
    run = make_gate(couple=0.4)
    plain = write_gate(run, tmp_path / "run.gate.json")
    small = write_gate(run, tmp_path / "run.gate.json.gz")
    assert gate_digest(read_gate(small)) == gate_digest(read_gate(plain))
    assert small.stat().st_size < plain.stat().st_size / 2


def test_the_same_gate_gives_the_same_bytes(tmp_path, make_gate):
    run = make_gate(couple=0.4)
    first, second = tmp_path / "a" / "x.gate.json.gz", tmp_path / "b" / "y.gate.json.gz"
    assert write_gate(run, first).read_bytes() == write_gate(run, second).read_bytes()


def test_a_compact_gate_keeps_every_count(tmp_path, make_gate):
    run = make_gate(couple=0.4)
    for residuals in (True, False):
        compact = compact_gate(run, residuals=residuals)
        assert (compact.counts == run.counts).all()
        assert bool(compact.strata) is residuals
        again = read_gate(write_gate(compact, tmp_path / f"{residuals}.gate.json.gz"))
        assert coordination(both_valid(again.pair_table())).delta == pytest.approx(
            coordination(both_valid(run.pair_table())).delta, abs=0, nan_ok=True
        )
    kept = compact_gate(run).strata["position"]
    assert np.allclose(kept.total, run.strata["position"].total, rtol=1e-10, atol=0)


def test_a_compact_gate_still_knows_which_conditions_it_counted(make_gate):
    run = make_gate(couple=0.4)
    run.conditions[:] = np.random.default_rng(0).normal(size=run.conditions.shape)
    compact = compact_gate(run)
    assert np.allclose(compact.conditions, run.conditions, rtol=1e-4, atol=0)
    others = replace(run, counts=run.counts[..., ::-1, ::-1].copy(), strata={}, provenance=run.provenance | {"seed": 1})
    merged = merge_gates([compact, others])
    assert merged.n_conditions == run.n_conditions
    assert (merged.counts == run.counts + others.counts).all()


def test_a_folder_of_compressed_gates_is_read(tmp_path, make_gate):
    write_gate(make_gate("one", couple=0.1), tmp_path / "one.gate.json.gz")
    write_gate(make_gate("two", couple=0.9), tmp_path / "two.gate.json")
    assert {found.label for found in read_inputs([tmp_path]).gates} == {"one", "two"}


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.9, 0.999])
def test_a_torn_file_is_refused_in_a_sentence(tmp_path, make_gate, share):
    path = write_gate(make_gate(), tmp_path / "run.gate.json.gz")
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ValueError, match=r"run.gate.json.gz is truncated or (damaged|not JSON)"):
        read_gate(path)


def test_a_flipped_byte_is_refused(tmp_path, make_gate):
    path = write_gate(make_gate(), tmp_path / "run.gate.json.gz")
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for position in rng.integers(10, len(whole), 60):
        changed = bytearray(whole)
        changed[position] ^= 1 << int(rng.integers(8))
        path.write_bytes(changed)
        with pytest.raises(ValueError, match=r"run\.gate\.json\.gz"):
            read_gate(path)


def test_a_bomb_is_not_unpacked(tmp_path):
    path = tmp_path / "bomb.gate.json.gz"
    with gzip.open(path, "wb") as file:
        for _ in range(MAX_DOCUMENT // 2**20 + 1):
            file.write(b" " * 2**20)
    with pytest.raises(ValueError, match="unpacks to more than"):
        read_gate(path)


def test_what_is_no_gzip_is_refused(tmp_path, make_gate):
    path = tmp_path / "run.gate.json.gz"
    path.write_text(write_gate(make_gate(), tmp_path / "run.gate.json").read_text())
    with pytest.raises(ValueError, match="truncated or damaged"):
        read_gate(path)
