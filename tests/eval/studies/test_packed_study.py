"""A study whose gates lie in a pack: the same study, and refused where pack and files contradict each other."""

from __future__ import annotations

from small_study import command, contents

from dualhead_eval.cli import main
from dualhead_eval.gate import write_gate
from dualhead_eval.gate.pack import GatePack
from dualhead_eval.studies.gate_store import study_results


def test_packed_gates_are_the_same_study_and_unpack_into_the_same_files(copied, capsys):
    before = contents(copied / "results")
    assert main(command(copied, "--verdict-only", "--pack")) == 0
    told = capsys.readouterr().out
    packs = list((copied / "results" / "gates").iterdir())
    assert [pack.name for pack in packs] == ["ring.gates.jsonl.xz"]
    count = sum(file.name.endswith(".gate.json.gz") and "gates" in file.parts for file in before)
    assert f"{count} gate files packed in" in told
    assert main(command(copied)) == 0  # neither data nor runs are there, nor needed
    assert f"{count} of {count} evaluations are there" in capsys.readouterr().out
    assert len(list(study_results(copied / "results" / "gates"))) == count
    assert main(["report", str(packs[0]), "--only", "A_independent-*/000150-large"]) == 0
    assert "B_shared_noise" not in capsys.readouterr().out
    assert main(command(copied, "--verdict-only", "--pack")) == 0  # nothing is left to pack
    assert "gate files packed" not in capsys.readouterr().out
    assert main(command(copied, "--verdict-only", "--unpack")) == 0
    after = contents(copied / "results")
    assert {file: content for file, (_, content) in after.items()} == {
        file: content for file, (_, content) in before.items()
    }


def test_a_file_that_contradicts_the_pack_is_named_and_neither_is_touched(copied, capsys):
    gates = copied / "results" / "gates"
    first, *_ = sorted(gates.rglob("*.gate.json.gz"))
    assert main(command(copied, "--verdict-only", "--pack")) == 0
    pack = gates / "ring.gates.jsonl.xz"
    packed = GatePack(pack)
    write_gate(packed.gate(packed.names[1]), first)
    before = contents(gates)
    for flag in ("--pack", "--unpack"):
        assert main(command(copied, "--verdict-only", flag)) == 2
        assert f"{first} is another gate than that of its name" in " ".join(capsys.readouterr().err.split())
    assert contents(gates) == before


def test_a_torn_pack_is_refused_by_its_name(copied, capsys):
    assert main(command(copied, "--verdict-only", "--pack")) == 0
    pack = copied / "results" / "gates" / "ring.gates.jsonl.xz"
    pack.write_bytes(pack.read_bytes()[:-100])
    capsys.readouterr()
    assert main(command(copied)) == 2
    assert "ring.gates.jsonl.xz is truncated" in capsys.readouterr().err
