"""The monitor study's statistics on logs whose truth is known: gaps that are there or not, gates, Holm, files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dualhead_eval.cli import main
from dualhead_eval.monitor.recorded_episodes import OBSERVATIONS
from dualhead_eval.report.monitor_page import monitor_page
from dualhead_eval.studies.monitor.arm_scores import ArmScores, coarse
from dualhead_eval.studies.monitor.conclusions import conclude
from dualhead_eval.studies.monitor.families import Families, FamilyMeasure, holm
from dualhead_eval.studies.monitor.figures import STUDY_CAPTIONS, study_figures
from dualhead_eval.studies.monitor.log_table import MonitorLog, read_log, write_log
from dualhead_eval.studies.monitor.recording import parts
from dualhead_eval.studies.monitor.regime import regime
from dualhead_eval.studies.monitor.registration import registered
from dualhead_eval.studies.monitor.scoring import joint_labels, labels_by_token
from dualhead_eval.studies.monitor.study import MonitorStudy
from dualhead_eval.studies.monitor.tables import practical_value, study_tables
from dualhead_eval.studies.monitor.verdicts import grade_distribution_rival

DECISIONS, FLAGGED = 20, (9, 10)


@pytest.fixture(scope="module")
def protocol():
    """The registered protocol with fewer draws and signals."""
    made = registered()
    inference = made.inference.model_copy(update={"draws": 199})
    scoring = made.scoring.model_copy(update={"signals": ["residual", "residual_matched"]})
    return made.model_copy(update={"inference": inference, "scoring": scoring})


def make_log(rng, calibration=60, nominal=60, cell=60, failing=0.5):
    """Episodes of twenty decisions of which two are flagged; those of one cell fail by half."""
    names = ["calibration"] * calibration + ["nominal"] * nominal + ["push@2"] * cell
    success = np.array([name != "push@2" or rng.random() > failing for name in names])
    episodes = {
        "part": names,
        "seed": list(range(len(names))),
        "success": success.tolist(),
        "failure": ["none" if won else "drop" for won in success],
        "stratum": ["push:491" if name == "push@2" else "nominal" for name in names],
        "steps": [8 * DECISIONS] * len(names),
        "onset": [None if name != "push@2" else 40 for name in names],
    }
    episode = np.repeat(np.arange(len(names)), DECISIONS)
    decision = np.tile(np.arange(DECISIONS), len(names))
    observations = {key: rng.normal(size=(len(episode), 3)).astype(np.float32) for key in OBSERVATIONS}
    about = {"env_id": "BimodalBypass-v2", "env_kwargs": {}, "layout": "panda", "horizon": 16, "state_names": None}
    return MonitorLog(episodes, episode, 8 * decision, np.isin(decision, FLAGGED), observations, about)


def make_scores(rng, log, signals, mismatch, *, tokens=False, warning=3.0):
    """Scores that rise late in failures and, in a share of the flagged decisions, by a mismatch."""
    failed = ~np.array(log.episodes["success"])[log.episode]
    crossed = log.flagged & (rng.random(len(log)) < mismatch)
    base = rng.gamma(4.0, 1.0, len(log)) + 100 * crossed + warning * 8 * (failed & (log.step > 80))
    n = 16
    sides = rng.integers(0, 2, (len(log), 2, n))
    if mismatch == 0:
        sides[:, 1] = sides[:, 0]
    pairs = np.stack([joint_labels(labels, 2) for labels in sides])
    followed = np.stack([labels_by_token(labels, labels[0], 2, 2) for labels in sides]) if tokens else None
    entropy = np.full(len(log), np.log(2), dtype=np.float32) if tokens else None
    return ArmScores({name: base.astype(np.float32) for name in signals}, crossed, pairs, followed, entropy, {})


@pytest.fixture(scope="module")
def found(protocol):
    """A baseline with mismatches at half of the flagged decisions, and an arm without any; six seeds."""
    rng = np.random.default_rng(0)
    log, signals = make_log(rng), protocol.scoring.signals
    seeds = protocol.presets["full"].seeds
    scored = {
        "A": {seed: make_scores(rng, log, signals, 0.5) for seed in seeds},
        "I": {seed: make_scores(rng, log, signals, 0.0, tokens=True) for seed in seeds},
    }
    return log, scored, conclude(log, scored, protocol, seeds)


def test_a_gap_that_is_taken_away_is_graded_so(found):
    verdicts = {verdict.name: verdict for verdict in found[2].verdicts["I"]}
    assert verdicts["P1"].grade == "met"
    assert verdicts["P1"].value == pytest.approx(-0.5, abs=0.1)
    assert verdicts["P1"].p_value == pytest.approx(1 / 200)
    assert verdicts["P2"].grade == "met"
    # All of the baseline's gap is mismatch, and the other arm has none.
    assert found[2].families["A", "residual"]["surcharge"].value == pytest.approx(0.5, abs=0.1)
    assert found[2].families["I", "residual"]["surcharge"].value == 0


def test_a_rival_that_compares_distributions_is_graded_where_it_was_registered(found, protocol):
    log, scored, conclusions = found
    assert {verdict.name for verdict in conclusions.verdicts["I"]} == {"P1", "P2", "S1", "S2", "S4"}
    assert MonitorStudy(protocol, "v2", "full", Path("S")).later is None
    later = MonitorStudy(protocol, "v3", "full", Path("S")).later
    assert later.S5.signal == "residual_energy"
    later = later.model_copy(update={"S5": later.S5.model_copy(update={"signal": "residual_matched"})})
    verdicts = {v.name: v for v in conclude(log, scored, protocol, protocol.presets["full"].seeds, later).verdicts["I"]}
    # Here all signals of the baseline are its residual: it detects less well, and keeps the whole gap.
    assert verdicts["S5a"].value == -verdicts["P2"].value
    assert verdicts["S5b"].value == -verdicts["P1"].value
    assert [verdicts[name].grade for name in ("S5a", "S5b")] == ["not met", "not met"]
    arm, rival = (conclusions.families[name, "residual"] for name in ("A", "I"))
    assert [verdict.grade for verdict in grade_distribution_rival(arm, rival, later.S5)] == ["met", "met"]


def test_an_arm_that_trains_nothing_is_graded_and_set_beside_the_trained_one(found, protocol):
    log, scored, conclusions = found
    own = {"A_aligned": scored["I"], "A_shared": scored["A"]}
    made = conclude(log, scored | own, protocol, protocol.presets["full"].seeds)
    aligned, shared = ({v.name: v for v in made.verdicts[name]} for name in own)
    assert "S6a" not in {verdict.name for verdict in conclusions.verdicts["I"]}
    assert [aligned[name].grade for name in ("P1", "P2", "S6a")] == ["met", "met", "reported"]
    assert aligned["P1"].value == {v.name: v for v in conclusions.verdicts["I"]}["P1"].value
    assert aligned["S6a"].value == aligned["S6b"].value == 0
    assert shared["P1"].grade != "met"
    assert shared["S6a"].value == -aligned["P1"].value
    named = {row[0] for row in study_tables(log, made, protocol)[0].rows}
    assert named == {"I - A", "A_aligned - A", "A_shared - A (no claim)"}


def test_arms_that_train_nothing_are_scored_with_the_policies_that_they_sample(tmp_path, protocol):
    study = MonitorStudy(protocol, "v2", "smoke", tmp_path / "S", arms=tmp_path / "arms")
    for seed in study.budget.seeds:
        folder = study.arm("A", seed) / "pretrained_model"
        folder.mkdir(parents=True)
        (folder / "config.json").write_text("{}")
    jobs = study.missing()
    first, last = study.budget.seeds[0], study.budget.seeds[-1]
    assert [job.target.stem for job in jobs] == [
        f"{arm}-{seed}" for arms in (["A"], ["A_aligned", "A_shared"]) for seed in (first, last) for arm in arms
    ]
    assert {job.policy for job in jobs} == {study.arm("A", seed) for seed in study.budget.seeds}
    assert jobs[0].coupling is None
    assert jobs[2].coupling.source_noise_alignment == "kinematic"
    study.scores_file("A_aligned", first).parent.mkdir(parents=True)
    study.scores_file("A_aligned", first).write_bytes(b"scored")
    assert f"A_aligned-{first}" not in {job.target.stem for job in study.missing()}


def test_a_threshold_per_flag_takes_the_gap_away_without_coordination(found):
    rivals = found[2].rivals
    assert rivals["A", "conformal:paper-step"]["gap"].value > 0.4
    assert abs(rivals["A", "mondrian:paper-step"]["gap"].value) < 0.05


def test_two_equal_arms_are_not_told_apart(protocol):
    rng = np.random.default_rng(1)
    log, signals = make_log(rng), protocol.scoring.signals
    seeds = protocol.presets["full"].seeds
    scored = {
        arm: {seed: make_scores(rng, log, signals, 0.5, tokens=arm == "I") for seed in seeds} for arm in ("A", "I")
    }
    verdicts = {verdict.name: verdict for verdict in conclude(log, scored, protocol, seeds).verdicts["I"]}
    assert verdicts["P1"].grade != "met"
    assert abs(verdicts["P1"].value) < 0.1


def test_fewer_seeds_than_registered_decide_nothing(found, protocol):
    log, scored, _ = found
    some = {arm: dict(list(by_seed.items())[:2]) for arm, by_seed in scored.items()}
    verdicts = conclude(log, some, protocol, protocol.presets["full"].seeds).verdicts["I"]
    assert {verdict.grade for verdict in verdicts} == {"not decided"}
    assert all("2 of 6 seeds scored so far" in verdict.reason for verdict in verdicts)


def test_heads_without_two_modes_are_not_tested(found, protocol):
    log, scored, _ = found
    collapsed = {}
    for seed, scores in scored["I"].items():
        pairs = np.zeros_like(scores.pairs)
        pairs[:, 0, 0] = 16
        collapsed[seed] = ArmScores(scores.scores, scores.crossed, pairs, scores.followed, scores.entropy, {})
    conclusions = conclude(log, {"A": scored["A"], "I": collapsed}, protocol, protocol.presets["full"].seeds)
    assert {verdict.grade for verdict in conclusions.verdicts["I"]} == {"not tested"}
    assert "capacity 0.00 < 0.25" in conclusions.verdicts["I"][0].reason


def test_a_token_that_nobody_obeys_fails_the_gate(found, protocol):
    log, scored, _ = found
    scores = next(iter(scored["I"].values()))
    obedient = regime(log, scores, 16)
    assert obedient.obedience == pytest.approx(1.0)
    assert not obedient.missed(protocol.gate)
    indifferent = scores.followed.copy()
    indifferent[:] = indifferent.mean(axis=2, keepdims=True).astype(np.uint8)
    disobeyed = regime(log, ArmScores(scores.scores, scores.crossed, scores.pairs, indifferent, scores.entropy, {}), 16)
    assert disobeyed.missed(protocol.gate) == [f"obedience {disobeyed.obedience:.2f} < 0.9"]
    assert disobeyed.obedience == pytest.approx(0.5, abs=0.05)


def test_the_baseline_must_be_scored(found, protocol):
    log, scored, _ = found
    with pytest.raises(ValueError, match="arm A has no scores"):
        conclude(log, {"I": scored["I"]}, protocol, [100])


def test_tables_and_figures_of_a_whole_study(found, protocol):
    log, _, conclusions = found
    tables = study_tables(log, conclusions, protocol)
    assert tables[0].title == "The registered criteria"
    assert "this environment: established, p = 0.0100 against 0.025" in tables[0].notes[0]
    figures = study_figures(conclusions)
    assert set(figures) == {"forest", "roc", "delay"}
    assert all(png.startswith(b"\x89PNG") for png in figures.values())
    assert monitor_page(tables, figures, STUDY_CAPTIONS).count("<figure>") == 3


def test_two_environments_are_tested_together(found, protocol):
    """The second of Holm's steps is at the whole level; an environment without scores is no step."""
    conclusions = found[2]
    (verdicts,) = conclusions.verdicts.values()
    p2 = replace(next(v for v in verdicts if v.name == "P2"), p_value=0.04)
    weaker = replace(conclusions, verdicts={"I": [v for v in verdicts if v.name != "P2"] + [p2]})
    alone = practical_value({"v3": weaker}, protocol)
    both = practical_value({"v3": weaker, "v2": conclusions}, protocol)
    assert alone[0].endswith("v3: not established, p = 0.0400 against 0.025")
    assert [line.rpartition("together), ")[2] for line in both] == [
        "v3: established, p = 0.0400 against 0.05",
        "v2: established, p = 0.0100 against 0.025",
    ]
    unscored = practical_value({"v3": replace(conclusions, verdicts={}), "v2": conclusions}, protocol)
    assert unscored[0].endswith("v3: arm I is not scored, nothing is decided")


def test_a_familys_interval_holds_the_spread_of_its_seeds():
    rng = np.random.default_rng(2)
    families = Families(50, 500, 0)
    values = rng.normal(0, 1, 6)
    runs = [({"m": float(v)}, {"m": np.full(500, v)}) for v in values]
    interval = families.family(runs)["m"].interval()
    half = 1.96 * values.std() / np.sqrt(6)
    assert interval.high - interval.low == pytest.approx(2 * half, rel=0.15)


def test_p_values_are_of_one_side():
    measure = FamilyMeasure(1.0, np.ones(1), np.linspace(0, 2, 101))
    assert measure.beyond(0.5, above=True) == pytest.approx((1 + 26) / 102)
    assert measure.beyond(0.5, above=False) == pytest.approx((1 + 76) / 102)


@pytest.mark.parametrize(
    ("p_values", "planned", "expected"),
    [
        ({"v2": 0.03}, 2, {"v2": False}),
        ({"v2": 0.02}, 2, {"v2": True}),
        ({"v2": 0.02, "v3": 0.04}, 2, {"v2": True, "v3": True}),
        ({"v2": 0.03, "v3": 0.001}, 2, {"v3": True, "v2": True}),
        ({"v2": 0.03, "v3": 0.04}, 2, {"v2": False, "v3": False}),
    ],
)
def test_holm(p_values, planned, expected):
    assert holm(p_values, 0.05, planned) == expected


def test_a_log_and_scores_are_read_as_written(tmp_path, found):
    log, scored, _ = found
    write_log(log, tmp_path / "log.parquet")
    again = read_log(tmp_path / "log.parquet")
    assert again.episodes == log.episodes
    assert again.about == log.about
    for name in ("episode", "step", "flagged"):
        np.testing.assert_array_equal(getattr(again, name), getattr(log, name))
    for key in OBSERVATIONS:
        np.testing.assert_array_equal(again.observations[key], log.observations[key])
    scores = next(iter(scored["I"].values()))
    scores.write(tmp_path / "I.parquet")
    kept = ArmScores.read(tmp_path / "I.parquet")
    for name, values in scores.scores.items():
        np.testing.assert_array_equal(kept.scores[name], coarse(values))
        np.testing.assert_allclose(kept.scores[name], values, rtol=2.0**-9)
    np.testing.assert_array_equal(kept.pairs, scores.pairs)
    np.testing.assert_array_equal(kept.followed, scores.followed)


@pytest.mark.parametrize("content", [b"", b"PAR1", b'{"a": 1}'])
def test_damaged_files_are_refused_in_a_sentence(tmp_path, content):
    for reader in (read_log, ArmScores.read):
        with pytest.raises(FileNotFoundError, match="does not exist, expected"):
            reader(tmp_path / "nothing.parquet")
        path = tmp_path / "damaged.parquet"
        path.write_bytes(content)
        with pytest.raises(ValueError, match="delete it, and repeat the study's command"):
            reader(path)


@pytest.mark.parametrize("which", ["log", "arm"])
def test_a_flipped_or_missing_byte_is_refused_or_harmless(tmp_path, found, which):
    log, scored, _ = found
    path = tmp_path / "file.parquet"
    if which == "log":
        write_log(log, path)
    else:
        next(iter(scored["I"].values())).write(path)
    reader = read_log if which == "log" else ArmScores.read
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    refusals = []
    for number in range(60):
        damaged = bytearray(whole)
        at = int(rng.integers(len(whole)))
        # Half of the damages lie in the footer, where a file says what it holds.
        at = max(at, len(whole) - 2000) if number % 2 else at
        if number % 5 == 0:
            del damaged[at:]
        else:
            damaged[at] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            reader(path)
        except ValueError as error:
            refusals.append(str(error))
    assert len(refusals) > 15
    assert all(str(path) in refusal and "\n" not in refusal for refusal in refusals)


def test_scores_that_diverged_stay_infinite():
    assert np.isinf(coarse(np.array([np.nan, np.inf]))).all()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--jobs", "0"], "--jobs 0 is not positive"),
        (["--arms", "nowhere"], "--arms nowhere is no folder"),
        (["--only-grade"], "log.parquet does not exist"),
        (["--beside", "nowhere"], "--beside nowhere is no folder"),
        (["--beside", ".", "--only-grade"], "--beside . holds no smoke study of v3"),
    ],
)
def test_a_study_that_cannot_begin_says_why(tmp_path, monkeypatch, capsys, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    assert main(["monitor", "study", "--output", "S", *arguments]) != 0
    said = capsys.readouterr().err.strip()
    assert sentence in said
    assert "\n" not in said


def test_a_study_does_not_go_on_in_another_ones_folder(tmp_path, capsys):
    (tmp_path / "S").mkdir()
    (tmp_path / "S" / "notes.txt").write_text("mine")
    assert main(["monitor", "study", "--output", str(tmp_path / "S"), "--only-grade"]) != 0
    assert "is not empty and holds no monitor study" in capsys.readouterr().err
    (tmp_path / "S" / "notes.txt").unlink()
    MonitorStudy(registered(), "v2", "smoke", tmp_path / "S").claim_folder()
    assert main(["monitor", "study", "--output", str(tmp_path / "S"), "--env", "v3", "--only-grade"]) != 0
    assert "holds a monitor study of another environment, preset or protocol" in capsys.readouterr().err


def test_what_is_kept_gives_the_same_verdicts(tmp_path, found, protocol):
    log, scored, conclusions = found
    study = MonitorStudy(protocol, "v2", "full", tmp_path / "S")
    study.claim_folder()
    write_log(log, tmp_path / "S" / "log.parquet")
    for arm, by_seed in scored.items():
        for seed, scores in by_seed.items():
            scores.write(study.scores_file(arm, seed))
    study.keep(tmp_path / "kept", log)
    kept = MonitorStudy(protocol, "v2", "full", tmp_path / "kept")
    kept.claim_folder()
    for key, values in log.observations.items():  # further arms are scored on what is kept
        np.testing.assert_array_equal(kept.log().observations[key], values)
    again = conclude(kept.log(), kept.scored(), protocol, study.budget.seeds)
    own = conclude(study.log(), study.scored(), protocol, study.budget.seeds)
    assert again.verdicts == own.verdicts
    assert [verdict.grade for verdict in own.verdicts["I"]] == [verdict.grade for verdict in conclusions.verdicts["I"]]


def test_the_kept_results_give_what_is_published(protocol):
    """The numbers of docs/monitor.md, from the files beside it."""
    root = Path(__file__).parents[3]
    study = MonitorStudy(registered(), "v2", "full", root / "results" / "monitor" / "v2")
    study.claim_folder()
    found = conclude(study.log(), study.scored(), protocol, study.budget.seeds)
    verdicts = {verdict.name: verdict for verdict in found.verdicts["I"]}
    assert verdicts["P1"].value == pytest.approx(-0.237, abs=5e-4)
    assert verdicts["P2"].value == pytest.approx(0.006, abs=5e-4)
    assert verdicts["S1"].value == pytest.approx(0.011, abs=5e-4)
    assert verdicts["S2"].value == pytest.approx(-0.011, abs=5e-4)
    assert verdicts["S4"].value == pytest.approx(-0.279, abs=5e-4)
    assert found.regimes["A"].capacity == pytest.approx(0.295, abs=5e-4)
    assert found.regimes["I"].obedience == pytest.approx(0.971, abs=5e-4)
    seeds = {arm: len(own) for arm, own in found.seeds.items()}
    text = (root / "docs" / "monitor.md").read_text()
    assert "six seeds of A and I" in text
    assert seeds == {"A": 6, "I": 6, "K": 6, "A_aligned": 6, "A_shared": 1}
    aligned = {verdict.name: verdict for verdict in found.verdicts["A_aligned"]}
    values = {"P1": -0.258, "P2": 0.009, "S1": 0.006, "S2": -0.015, "S4": -0.300, "S6a": -0.020, "S6b": 0.004}
    assert {name: verdict.value for name, verdict in aligned.items()} == pytest.approx(values, abs=6e-4)
    assert [aligned[name].grade for name in ("P1", "P2")] == ["met", "not decided"]
    assert found.regimes["A_aligned"].delta == pytest.approx(0.276, abs=5e-4)


def test_the_kept_results_of_v3_give_what_is_published():
    root = Path(__file__).parents[3]
    study = MonitorStudy(registered(), "v3", "full", root / "results" / "monitor" / "v3")
    assert study.is_claimed()
    found = conclude(study.log(), study.scored(), study.protocol, study.budget.seeds, study.later)
    verdicts = {verdict.name: verdict for verdict in found.verdicts["I"]}
    values = {"P1": -0.221, "P2": 0.018, "S1": 0.014, "S2": -0.001, "S4": -0.255, "S5a": 0.006, "S5b": -0.092}
    assert {name: verdict.value for name, verdict in verdicts.items()} == pytest.approx(values, abs=6e-4)
    assert [verdicts[name].grade for name in ("P1", "P2", "S5a", "S5b")] == ["met", "met", "not decided", "met"]


def test_no_seed_of_the_log_is_used_twice(protocol):
    for budget in protocol.presets.values():
        seeds = [
            seed for part in parts(protocol, budget) for seed in range(part.first_seed, part.first_seed + part.episodes)
        ]
        assert len(set(seeds)) == len(seeds)
    full = parts(protocol, protocol.presets["full"])
    assert sum(part.episodes for part in full) >= 1200
