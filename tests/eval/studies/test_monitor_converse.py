"""The monitor study's converse: decisions of real demonstrations, tallies whose truth is known, grades, files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dualhead_envs.bypass.record import record_bypass
from dualhead_envs.dataset_frames import read_split
from dualhead_eval.cli import main
from dualhead_eval.studies.monitor.converse.curve import curve, run_measures, verdicts
from dualhead_eval.studies.monitor.converse.decisions import flagged_decisions, grid_decisions
from dualhead_eval.studies.monitor.converse.figure import converse_figure
from dualhead_eval.studies.monitor.converse.protocol import ConverseBudget, ConverseProtocol, registered_converse
from dualhead_eval.studies.monitor.converse.scoring import on_two_sides, residual_mm, tally_reading
from dualhead_eval.studies.monitor.converse.study import ConverseStudy
from dualhead_eval.studies.monitor.converse.tables import converse_tables
from dualhead_eval.studies.monitor.converse.tally import RunTally, read_tally

PAIRS, DECISIONS, SAMPLES = 24, 8, 32
#: Standard deviation of a simulated head's offset, mm.
SPREAD = 10.0


@pytest.fixture(scope="module")
def protocol():
    """The registered protocol with fewer draws."""
    made = registered_converse()
    return made.model_copy(update={"inference": made.inference.model_copy(update={"draws": 199})})


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A few demonstrations with a side step of 20 mm."""
    root = tmp_path_factory.mktemp("data") / "020mm"
    settings = {"obstacle": "none", "amplitude": 0.02}
    return record_bypass("BimodalBypass-v2", root, pairs=4, env_kwargs=settings, workers=1, progress=False)


def graded(points, protocol):
    return verdicts(points, protocol, protocol.presets["full"])


def simulated(rng, amplitude, arm, seed, *, known_sides=True):
    """A run whose heads lie `amplitude` to either side of the middle, with Gaussian noise along and beside it."""
    shape = (PAIRS * DECISIONS, SAMPLES)
    pair = np.repeat(np.arange(PAIRS), DECISIONS)

    def residual_of(a, b):
        return np.hypot(a - b, rng.normal(0, 2 * SPREAD, a.shape))

    sides = rng.choice([-1, 1], (2, *shape))
    a, b = amplitude * sides + rng.normal(0, SPREAD, (2, *shape))
    calm = residual_of(*rng.normal(0, SPREAD, (2, *shape)))
    crossed = sides[0] != sides[1] if known_sides else np.sign(a) != np.sign(b)
    threshold = float(np.quantile(calm, 0.95))
    reading = tally_reading(threshold, residual_of(a, b), crossed, pair, calm, pair, PAIRS)
    readings = {"A": reading} if arm == "A" else {"K apart": reading}
    return RunTally(
        format="dualhead-monitor-converse-run/1", amplitude_mm=amplitude, arm=arm, seed=seed,
        separation_mm=[2.0 * amplitude] * PAIRS, readings=readings, provenance={},
    )  # fmt: skip


@pytest.fixture(scope="module")
def tallies(protocol):
    rng = np.random.default_rng(0)
    return [
        simulated(rng, amplitude, arm, seed, known_sides=arm == "K")
        for amplitude, arm, seed in protocol.presets["full"].runs()
    ]


def test_flagged_steps_are_shared_by_both_demonstrations_and_end_at_the_branch(recorded, protocol):
    split = read_split(recorded / "train")
    flagged = flagged_decisions(split, protocol.decisions, 16)
    pairs = len(np.unique(split.labels["pair"]))
    assert protocol.decisions.flagged_to <= split.labels["branch_step"].min()
    assert flagged.n_pairs == pairs
    assert np.bincount(flagged.pair).tolist() == [DECISIONS] * pairs
    grown = flagged.separation.reshape(pairs, -1)
    assert (np.diff(grown, axis=1) > 0).all(), "the later the step, the more of the next sixteen are apart"
    starts = [np.flatnonzero((split.frame_index == 84) & (split.labels["mode"] == mode))[0] for mode in (0, 1)]
    left, right = (split.action[start : start + 16, 7:10].astype(np.float64) for start in starts)
    assert grown[0, -1] == pytest.approx(1000 * np.linalg.norm(left - right, axis=1).mean())
    np.testing.assert_allclose(flagged.middle, 0.0, atol=0.01)


def test_the_flag_is_that_of_the_wall_translated_into_steps(protocol, tmp_path):
    root = record_bypass("BimodalBypass-v2", tmp_path / "v2", pairs=3, workers=1, progress=False)
    split = read_split(root / "train")
    earlier = protocol.decisions.model_copy(update={"flagged_from": protocol.decisions.flagged_from - 1})
    separation = flagged_decisions(split, earlier, 16).separation
    assert separation[0] < 20 < separation[1]


def test_the_grid_leaves_out_what_is_flagged_if_told_so(recorded, protocol):
    split = read_split(recorded / "val")
    whole = grid_decisions(split, protocol.decisions)
    rest = grid_decisions(split, protocol.decisions, flagged=False)
    steps = int(split.frame_index.max()) // protocol.decisions.every + 1
    assert len(whole.pair) == 2 * steps
    assert len(rest.pair) == 2 * (steps - 1)


def test_demonstrations_that_part_earlier_are_refused(recorded, protocol):
    late = protocol.decisions.model_copy(update={"flagged_to": 100})
    with pytest.raises(ValueError, match="part before step 100"):
        flagged_decisions(read_split(recorded / "val"), late, 16)


def test_chunks_are_on_two_sides_by_where_they_end():
    paths = np.zeros((1, 3, 16, 3))
    paths[0, :, -1, 1] = [0.03, 0.01, -0.01]
    other = np.zeros((1, 3, 16, 3))
    other[0, :, -1, 1] = 0.01
    assert on_two_sides(paths, other, np.array([0.0])).tolist() == [[False, False, True]]
    assert on_two_sides(paths, other, np.array([0.02])).tolist() == [[True, False, False]]
    assert residual_mm(paths, other)[0, 2] == pytest.approx(20 / 16)


def test_alarms_are_counted_by_side_and_pair():
    residual = np.array([[1.0, 9.0], [9.0, 9.0], [1.0, 1.0]])
    crossed = np.array([[False, True], [False, True], [True, True]])
    reading = tally_reading(5.0, residual, crossed, np.array([0, 0, 1]), np.array([[9.0]]), np.array([1]), 2)
    assert (reading.same, reading.same_alarms, reading.same_mm) == ([2, 0], [1, 0], [10.0, 0.0])
    assert (reading.cross, reading.cross_alarms) == ([2, 2], [2, 0])
    assert (reading.other, reading.other_alarms) == ([0, 1], [0, 1])
    values, drawn = run_measures(reading, np.array([4.0, 8.0]), np.array([[1.0, 1.0], [2.0, 0.0]]))
    assert values["flagged"] == drawn["flagged"][0] == 0.5
    assert values["surcharge"] == 0.0
    assert drawn["surcharge"][1] == 0.75 - 0.5
    assert (values["floor"], values["separation"], values["ratio"]) == (5.0, 6.0, 1.2)


def test_known_sides_show_no_surcharge_where_the_ways_are_one_and_sides_from_paths_do(tallies, protocol):
    points = {(point.reading, point.amplitude_mm): point for point in curve(tallies, protocol)}
    known, told = points["K apart", 0], points["A", 0]
    assert 0.0 in known.measures["surcharge"].interval()
    assert known.finding(protocol.criteria.equivalence) == "none"
    assert told.measures["surcharge"].interval().low > 0.002, "two sides of any line are further apart than one"
    assert told.graded is None
    five = points["A", 5].graded
    assert five is not None
    assert five.value == pytest.approx(
        points["A", 5].measures["surcharge"].value - told.measures["surcharge"].value, abs=1e-12
    )


def test_the_converse_of_simulated_heads_holds_at_its_two_ends(tallies, protocol):
    points = curve(tallies, protocol)
    # Just below 1 a Gaussian's surcharge exceeds the margin; the registration foresees it.
    criteria = protocol.criteria.model_copy(update={"ratio": 0.6})
    found = {(p.reading, p.name): p for p in graded(points, protocol.model_copy(update={"criteria": criteria}))}
    assert found["K apart", "C1"].grade == "met"
    assert found["K apart", "C2"].grade == "met"
    assert found["A", "C2"].grade == "met"
    assert set(found["A", "C1"].amplitudes_mm) | set(found["A", "C2"].amplitudes_mm) == {5, 10, 20, 40, 80, 165}
    assert 165 in found["A", "C2"].amplitudes_mm


def test_a_surcharge_where_the_ways_are_one_is_not_met(protocol, tallies):
    wrong = []
    for tally in tallies:
        if tally.arm == "K" and tally.amplitude_mm == 0:
            reading = tally.readings["K apart"]
            alarms = [n // 2 for n in reading.cross]
            tally = tally.model_copy(
                update={"readings": {"K apart": reading.model_copy(update={"cross_alarms": alarms})}}
            )
        wrong.append(tally)
    found = {(one.reading, one.name): one.grade for one in graded(curve(wrong, protocol), protocol)}
    assert found["K apart", "C1"] == "not met"


def test_what_is_not_all_scored_is_not_decided(protocol, tallies):
    some = [tally for tally in tallies if not (tally.arm == "K" and tally.amplitude_mm == 165)]
    found = {(one.reading, one.name): one.grade for one in graded(curve(some, protocol), protocol)}
    assert found["K apart", "C1"] == "not decided"
    only = [tally for tally in tallies if tally.amplitude_mm == 0]
    assert {one.grade for one in graded(curve(only, protocol), protocol)} == {"not decided", "not tested"}


def test_tables_and_figure_show_every_reading(tallies, protocol):
    points = curve(tallies, protocol)
    tables = converse_tables(points, graded(points, protocol), protocol, protocol.presets["full"])
    assert len(tables[0].rows) == len(points) == 12
    assert converse_figure(points, protocol).startswith(b"\x89PNG")


def test_a_run_is_read_as_it_was_written(tmp_path, tallies):
    tallies[0].write(tmp_path / "run.json")
    assert read_tally(tmp_path / "run.json") == tallies[0]
    document = json.loads((tmp_path / "run.json").read_text())
    document["readings"]["A"]["same"] = [0] * PAIRS
    (tmp_path / "run.json").write_text(json.dumps(document))
    with pytest.raises(ValueError, match="more alarms than pairs"):
        read_tally(tmp_path / "run.json")
    document["separation_mm"] = [1.0]
    (tmp_path / "run.json").write_text(json.dumps(document))
    with pytest.raises(ValueError, match="another length"):
        read_tally(tmp_path / "run.json")


def test_a_protocol_without_its_reference_is_refused():
    document = registered_converse().model_dump()
    document["presets"]["full"]["amplitudes_mm"]["A"] = [5, 10]
    with pytest.raises(ValueError, match="not 0 mm of arm A"):
        ConverseProtocol(**document)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--jobs", "0"], "--jobs 0 is not positive"),
        (["--figure", "x.pdf"], "should end in .png"),
        (["--only-grade"], "is no folder"),
        (["--amplitudes", "7"], "--amplitudes 7: expected some of [0, 20, 40, 165]"),
        (["--amplitudes", "20", "--arms", "K"], "choose no run"),
    ],
)
def test_a_command_that_cannot_begin_says_why(tmp_path, monkeypatch, capsys, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    assert main(["monitor", "converse", "--output", "S", *arguments]) != 0
    said = capsys.readouterr().err.strip()
    assert sentence in said
    assert "\n" not in said
    assert not list(tmp_path.iterdir())


def test_a_command_does_not_go_on_in_another_ones_folder(tmp_path, capsys, protocol):
    (tmp_path / "S").mkdir()
    (tmp_path / "S" / "notes.txt").write_text("mine")
    assert main(["monitor", "converse", "--output", str(tmp_path / "S"), "--only-grade"]) != 0
    assert "is not empty and holds no converse" in capsys.readouterr().err
    (tmp_path / "S" / "notes.txt").unlink()
    ConverseStudy(protocol, "smoke", tmp_path / "S").claim_folder()
    assert main(["monitor", "converse", "--output", str(tmp_path / "S"), "--only-grade"]) != 0
    assert "another preset or protocol" in capsys.readouterr().err


def test_what_is_kept_is_graded_alike(tmp_path, capsys, tallies):
    study = ConverseStudy(registered_converse(), "full", tmp_path / "S")
    study.claim_folder()
    for tally in tallies:
        tally.write(study.run_file(tally.amplitude_mm, tally.arm, tally.seed))
    assert not study.missing()
    kept = tmp_path / "kept"
    command = [
        "monitor",
        "converse",
        "--preset",
        "full",
        "--output",
        str(study.root),
        "--only-grade",
        "--keep",
        str(kept),
    ]
    assert main(command) == 0
    assert "C1: no surcharge below a ratio of 1" in capsys.readouterr().out
    assert ConverseStudy(registered_converse(), "full", kept).tallies() == study.tallies()
    assert main(command) != 0
    assert "give another --keep" in capsys.readouterr().err


def test_a_whole_study_of_the_smallest_size(tmp_path, protocol):
    smallest = ConverseBudget(pairs=3, steps=2, seeds=[1], amplitudes_mm={"A": [0], "K": [20]})
    scoring = protocol.scoring.model_copy(update={"samples": 1, "flagged_samples": 3})
    small = protocol.model_copy(update={"presets": {"smoke": smallest}, "scoring": scoring})
    study = ConverseStudy(small, "smoke", tmp_path / "S")
    study.claim_folder()
    for _ in range(2):  # the second time there is nothing to do
        study.record()
        study.train()
        study.score()
    a, k = study.tallies()
    assert (list(a.readings), len(a.separation_mm), a.separation_mm[0]) == (["A"], 1, 0.0)
    assert list(k.readings) == ["K apart", "K apart, sides from paths", "K together"]
    assert sum(k.readings["K together"].cross) == 0
    assert 0 < sum(k.readings["K apart"].cross) < DECISIONS * 3
    for reading in k.readings.values():
        assert sum(reading.same) + sum(reading.cross) == DECISIONS * 3
    text = "".join(path.read_text() for path in (study.root / "runs").iterdir())
    assert str(tmp_path) not in text, "what is kept names no folder of this machine"
    assert Path(study.policy(0, "A", 1)).is_dir()
