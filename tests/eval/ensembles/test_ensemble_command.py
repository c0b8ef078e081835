"""``dualhead ensemble`` from the outside, and what its tables say."""

import pytest

from dualhead_eval.cli import main
from dualhead_eval.ensembles.summary import paper_ensemble, summarise_ensemble
from dualhead_eval.gate import read_gate
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.report.ensemble_tables import contamination_table, ensemble_choices_table

FILES = ("private", "shared", "vfd", "vfd_unweighted")


@pytest.fixture(scope="module")
def folder(members, ring_data, tmp_path_factory):
    output = tmp_path_factory.mktemp("ensembles") / "trio"
    arguments = ["ensemble", *map(str, members), "--dataset", str(ring_data / "test"), "--output", str(output)]
    assert main([*arguments, "--pairs", "200", "--vfd-pairs", "20"]) == 0
    return output


def test_it_writes_a_gate_file_a_score_and_prints_both_tables(members, ring_data, tmp_path, capsys):
    arguments = ["ensemble", *map(str, members[:2]), "--dataset", str(ring_data / "test")]
    arguments += ["--output", str(tmp_path / "pair"), "--pairs", "16", "--vfd-pairs", "8", "--conditions", "3"]
    assert main(arguments) == 0
    shown = capsys.readouterr().out
    assert {path.name for path in (tmp_path / "pair").iterdir()} == {f"{name}.gate.json" for name in FILES}
    assert "Do the members of an ensemble choose modes together?" in shown
    assert "What is an ensemble's disagreement made of?" in shown
    assert shown.count("Action-L2") == 2
    assert "unweighted" in shown
    assert main(arguments) == 2
    assert "exists: choose another name or add --overwrite" in capsys.readouterr().err
    assert main([*arguments, "--overwrite"]) == 0


def test_shared_noise_makes_members_choose_together_and_private_noise_does_not(folder):
    private, shared = (summarise_ensemble(read_gate(folder / f"{name}.gate.json")) for name in ("private", "shared"))
    assert abs(private.over_pairs["rho"].mean) < 0.1
    assert shared.over_pairs["rho"].high > 0.5, "two members of one objective start alike and end alike"
    assert private.over_pairs["cross_share"].mean > shared.over_pairs["cross_share"].mean
    assert (private.members, private.pairs, private.unit) == (3, 200, "mm")


def test_the_tables_hold_what_the_gates_say(folder):
    gates = [read_gate(folder / f"{name}.gate.json") for name in FILES]
    choices, shares = ensemble_choices_table(gates), contamination_table(gates)
    assert [row[1] for row in choices.rows] == ["private", "shared"]
    assert [row[1] for row in shares.rows] == ["Action-L2", "Action-L2", "VFD", "VFD, unweighted"]
    for gate, row in zip(gates, shares.rows, strict=True):
        share = summarise_ensemble(gate).over_pairs["cross_share"]
        assert row[7] == f"{share.mean:.1%} [{100 * share.low:.1f},{100 * share.high:.1f}]"
        assert row[3] == ("20" if gate.provenance["score"].startswith("vfd") else "200")


def test_it_is_reported_like_any_other_run(folder, capsys):
    assert main(["report", str(folder)]) == 0
    assert "What is an ensemble's disagreement made of?" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("objectives", "row"),
    [
        ([(1.0, 0.0)] * 2, "b1_l0"),
        ([(0.0, 0.0)] * 2, "b0_l0"),
        ([(0.0, 3.0)] * 2, "b0_l3"),
        ([(1.0, 0.0), (0.0, 3.0)], "mixed objectives"),
        ([(0.1, 3.0)] * 2, None),
    ],
)
def test_the_papers_row_is_that_of_the_members_objectives(make_gate, objectives, row):
    members = {
        f"member {i}": {"config": {"source_noise_beta": beta, "consistency_weight": weight}}
        for i, (beta, weight) in enumerate(objectives)
    }
    gate = make_gate(partition="bypass-v2", members=members, method="ensemble")
    assert paper_ensemble(gate) == row
    assert mechanism_of(gate).paper_row == ""  # no pair of its members is two heads
    assert paper_ensemble(make_gate(partition="ring", members=members)) is None
    members["member 0"]["config"]["token"] = "oracle"
    assert paper_ensemble(make_gate(partition="bypass-v2", members=members)) is None


def test_the_papers_numbers_stand_beside_those_of_v2(make_gate):
    members = {f"m{i}": {"config": {"source_noise_beta": 1.0, "consistency_weight": 0.0}} for i in range(2)}
    for shared, cells in ((True, ("0.1434", "+0.3632", "0.9305")), (False, ("-", "-", "0.9296"))):
        gate = make_gate(
            heads=2, partition="bypass-v2", members=members, method="ensemble", shared_noise=shared, score="action_l2"
        )
        gate.strata["joint / position"] = gate.strata.pop("position")
        (row,) = ensemble_choices_table([gate]).rows
        assert row[-3:] == cells
        (row,) = contamination_table([gate]).rows
        assert row[-2] == ("-" if shared else "[92.0,95.0]")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda members, options: (members[:1], options), "expected 2 to 8"),
        (lambda members, options: ([members[0], members[0]], options), "the same checkpoint"),
        (lambda members, options: ([members[0], members[0].parent / "gone"], options), "gone"),
        (lambda members, options: (members[:2], {**options, "--vfd-pairs": 0}), "pairs=0 is not positive"),
        (lambda members, options: (members[:2], {**options, "--nfe": 0}), "at least 1"),
        (lambda members, options: (members[:2], {**options, "--conditions": 99}), "99 were asked for"),
        (lambda members, options: (members[:2], {**options, "--dataset": members[0]}), "not a LeRobotDataset"),
    ],
)
def test_mistakes_are_one_sentence_and_leave_nothing(members, ring_data, tmp_path, capsys, change, sentence):
    given, options = change(members, {"--dataset": ring_data / "test", "--output": tmp_path / "out"})
    words = [str(word) for pair in options.items() for word in pair]
    assert main(["ensemble", *map(str, given), *words]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.strip().count(chr(10)) == 0
    assert not (tmp_path / "out").exists()


def test_members_of_another_robot_are_refused(members, panda_data, tmp_path, capsys):
    words = ["--dataset", str(panda_data / "test"), "--output", str(tmp_path / "out")]
    assert main(["ensemble", *map(str, members[:2]), *words]) == 2
    assert "the policy's layout is 'ring/nullspace'" in capsys.readouterr().err
