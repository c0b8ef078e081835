"""The regime sweep: its law, its prediction, its intervals, its command."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from dualhead_eval.cli import main
from dualhead_eval.monitor.thresholds.threshold import conformal_quantile
from dualhead_eval.studies.monitor.regimes.definition import FLOOR, Cell, SamplerOptions, read_sweep
from dualhead_eval.studies.monitor.regimes.heads import ARMS, Drawn, Heads, rarer_token
from dualhead_eval.studies.monitor.regimes.outcome import outcome
from dualhead_eval.studies.monitor.regimes.prediction import ResidualLaw, demonstrated_residuals
from dualhead_eval.studies.monitor.regimes.sweep import as_csv, run_sweep

ROOT = Path(__file__).parents[3]
KEPT = ROOT / "results/monitor/regimes"
OPTIONS = SamplerOptions(representation="orthogonal", euler_steps=200, seed=0)
EVEN = math.log(2)


def heads(arm, *, prior=0.5, token_entropy=EVEN, replacement=0.0, separation=4.0):
    cell = Cell(prior=prior, token_entropy=token_entropy, replacement=replacement, separation=separation)
    return Heads(cell, arm, OPTIONS)


def small_definition(**changes):
    """The registered sweep in two cells and few decisions."""
    document = read_sweep().model_dump(mode="json")
    decisions = {"calibration": 400, "flagged": 300, "other": 300}
    document["axes"] = {"prior": [0.8], "token_entropy": [0.3], "replacement": [0.1], "separation": [0.5, 4.0]}
    document["decisions"] = document["paper"]["decisions"] = decisions
    document["sampler"]["euler_steps"] = 20
    return document | changes


def written(document, folder):
    path = folder / "definition.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


def test_the_registered_sweep_has_four_levels_of_four_axes():
    sweep = read_sweep()
    assert len(list(sweep.axes.cells())) == 4**4
    assert sweep.paper.cells["control"].separation * FLOOR < 2


@pytest.mark.parametrize("entropy", [1e-3, 0.012, 0.3, EVEN])
def test_the_rarer_token_gives_the_entropy_it_was_asked_for(entropy):
    rare = rarer_token(entropy)
    assert 0 < rare <= 0.5
    assert -rare * math.log(rare) - (1 - rare) * math.log1p(-rare) == pytest.approx(entropy, rel=1e-6)


def test_heads_mismatch_as_prior_tokens_and_obedience_say():
    assert heads("none", prior=0.8).mismatch == pytest.approx(2 * 0.8 * 0.2)
    assert heads("shared").mismatch == 0
    assert heads("apart").mismatch == pytest.approx(0.5)
    # Of tokens that are replaced at random, 1 - .6 / 2 name the mode.
    assert heads("shared", replacement=0.6).mismatch == pytest.approx(2 * 0.7 * 0.3)
    # Tokens that say nothing leave the prior, whoever follows which.
    for arm in ("apart", "shared"):
        assert heads(arm, prior=0.8, replacement=1.0).mismatch == pytest.approx(2 * 0.8 * 0.2)


@pytest.mark.parametrize("arm", ARMS)
def test_the_samplers_cross_as_often_as_their_law_says(arm):
    measured = heads(arm, prior=0.8, token_entropy=0.5, replacement=0.2)
    drawn = measured.flagged(3000, "test")
    error = 4 * math.sqrt(0.25 / 3000)
    # The modes overlap in a fifth of a percent of the chunks.
    assert drawn.crossed.mean() == pytest.approx(measured.mismatch, abs=error + 0.004)


def test_chunks_of_one_mode_are_as_far_apart_as_demonstrations_of_it():
    law = demonstrated_residuals(heads("none").cell.mode_angle, pairs=20_000)
    drawn = heads("none").other(20_000, "test").residual
    for level in (0.5, 0.9, 0.95):  # 200 Euler steps leave the points' own noise a little too small
        assert np.quantile(drawn, level) == pytest.approx(np.quantile(law.within, level), rel=0.05)


@pytest.mark.parametrize(("share", "mismatch"), [(0.052, 0.5), (0.052, 0.02), (0.31, 0.1), (0.31, 0.5), (0.31, 0.2)])
def test_modes_far_apart_cost_false_alarms_up_to_alpha_and_missed_failures_beyond(share, mismatch):
    """The two-line form: gap x (1 - e) with e = (alpha - f x) / (1 - f x), or alpha / f."""
    rng = np.random.default_rng(0)
    law = ResidualLaw(np.sort(rng.rayleigh(50.0, 200_000)), np.sort(1e4 + rng.rayleigh(50.0, 200_000)))
    predicted = law.predict(share, mismatch, 0.05)
    load = share * mismatch
    if load < 0.05:
        floor = (0.05 - load) / (1 - load)
        assert predicted.gap == pytest.approx(mismatch * (1 - floor), abs=1e-3)
        assert predicted.threshold == pytest.approx(50 * math.sqrt(-2 * math.log(floor)), rel=0.02)
    else:
        assert predicted.gap == pytest.approx(0.05 / share, abs=1e-3)
        assert predicted.other == 0
        assert predicted.threshold > 1e4


def test_modes_that_coincide_cost_nothing():
    law = demonstrated_residuals(Cell(prior=0.5, token_entropy=EVEN, replacement=0, separation=1e-4).mode_angle)
    assert abs(law.predict(0.31, 0.5, 0.05).gap) < 2e-3


@pytest.mark.parametrize("separation", [0.5, 4.0])
@pytest.mark.parametrize("share", [0.052, 0.31])
def test_the_prediction_is_what_the_alarms_do(separation, share):
    arm = heads("none", prior=0.8, separation=separation)
    rng = np.random.default_rng(1)
    n = int(rng.binomial(4000, share))
    calibration = np.concatenate([arm.flagged(n, "a").residual, arm.other(4000 - n, "b").residual])
    found = outcome(calibration, arm.flagged(4000, "c"), arm.other(4000, "d"), alpha=0.05, draws=500, rng=rng)
    law = demonstrated_residuals(arm.cell.mode_angle)
    predicted = law.predict(share, arm.mismatch, 0.05)
    standard_error = found.gap.replicates.std()
    assert abs(found.gap.value - predicted.gap) < 4 * standard_error + 0.002
    assert found.flagged - found.other == pytest.approx(found.gap.value)


def test_the_intervals_are_those_of_plain_resampling():
    rng = np.random.default_rng(0)
    calibration = rng.rayleigh(1.0, 300)
    crossed = rng.random(200) < 0.4
    sides = np.stack([np.zeros(200, dtype=np.int64), crossed.astype(np.int64)], axis=-1)
    flagged = Drawn(rng.rayleigh(1.0, 200) + crossed, sides, None)
    other = Drawn(rng.rayleigh(1.0, 250), np.zeros((250, 2), dtype=np.int64), None)
    found = outcome(calibration, flagged, other, alpha=0.1, draws=4000, rng=rng)
    gaps, surcharges = [], []
    for _ in range(4000):
        limit = conformal_quantile(rng.choice(calibration, 300), 0.1)
        drawn = rng.integers(200, size=200)
        beyond, apart = flagged.residual[drawn] > limit, crossed[drawn]
        gaps.append(beyond.mean() - (rng.choice(other.residual, 250) > limit).mean())
        surcharges.append(beyond.mean() - beyond[~apart].mean())
    for estimate, replicates in ((found.gap, gaps), (found.surcharge, surcharges)):
        assert estimate.replicates.std() == pytest.approx(np.std(replicates), rel=0.06)
        for level in (0.025, 0.5, 0.975):
            assert np.quantile(estimate.replicates, level) == pytest.approx(np.quantile(replicates, level), abs=0.01)


def test_a_cell_does_not_depend_on_what_else_is_swept(tmp_path):
    document = small_definition()
    both = run_sweep(read_sweep(written(document, tmp_path)))
    document["axes"]["separation"] = [4.0]
    document["paper"]["cells"] = {"control": document["paper"]["cells"]["control"]}
    document["criteria"]["R5"] = {"invisible": [], "visible": ["control"]}
    alone = run_sweep(read_sweep(written(document, tmp_path)))
    kept = [("", one) for one in both.grid if one.cell.separation == 4.0]
    assert as_csv([("", one) for one in alone.grid]) == as_csv(kept)
    assert as_csv([("", one) for one in alone.paper["control"]]) == as_csv([("", r) for r in both.paper["control"]])


def test_the_command_writes_cells_criteria_and_a_figure_and_overwrites_nothing(tmp_path, capsys):
    arguments = ["monitor", "regimes", "--definition", str(written(small_definition(), tmp_path))]
    assert main([*arguments, "--output", str(tmp_path / "out")]) == 0
    assert "The registered criteria" in capsys.readouterr().out
    rows = list(csv.DictReader((tmp_path / "out/cells.csv").open()))
    assert len(rows) == 2 * 3 * 2 + 2 * 6  # separations x arms x flagged shares, and the paper's cells
    assert {row["obedience"] for row in rows if row["arm"] == "none"} == {""}
    criteria = json.loads((tmp_path / "out/criteria.json").read_text())["criteria"]
    assert {one["name"] for one in criteria} == {"R1", "R2", "R3", "R4", "R5"}
    assert (tmp_path / "out/regimes.png").stat().st_size > 10_000
    assert main([*arguments, "--output", str(tmp_path / "out")]) == 2
    assert "choose another output folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"alpha": 0.001}, "expected at least 999 at alpha 0.001"),
        (
            {"axes": {"prior": [0.3], "token_entropy": [0.3], "replacement": [0], "separation": [4]}},
            "axes.prior.0 = 0.3",
        ),
        ({"axes": {"prior": [0.5], "token_entropy": [0.8], "replacement": [0], "separation": [4]}}, "token_entropy.0"),
        ({"axes": {"prior": [0.5], "token_entropy": [0.3], "replacement": [0], "separation": [15]}}, "separation.0"),
        ({"axes": {"prior": [], "token_entropy": [0.3], "replacement": [0], "separation": [4]}}, "axes.prior"),
        ({"flagged_shares": [1.5]}, "flagged_shares.0"),
        ({"more": 1}, "unknown field 'more'"),
    ],
)
def test_a_definition_that_is_none_is_refused_in_a_sentence(change, sentence, tmp_path, capsys):
    path = written(small_definition(**change), tmp_path)
    assert main(["monitor", "regimes", "--definition", str(path), "--output", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert "change its numbers" in error
    assert not (tmp_path / "out").exists()


def test_a_criterion_may_only_name_the_papers_cells(tmp_path):
    document = small_definition()
    document["criteria"]["R5"]["visible"] = ["elsewhere"]
    with pytest.raises(ValueError, match="names the paper's cell 'elsewhere'"):
        read_sweep(written(document, tmp_path))


def test_the_kept_results_are_those_of_the_registered_sweep(tmp_path):
    """One cell of the committed run, computed again."""
    kept = json.loads((KEPT / "criteria.json").read_text())["definition"]
    assert kept == read_sweep().model_dump(mode="json")
    axes = {"prior": [0.92], "token_entropy": [0.3], "replacement": [0.1], "separation": [2.0]}
    few = {"control": kept["paper"]["cells"]["control"]}
    small = {"calibration": 19, "flagged": 1, "other": 1}
    document = kept | {"axes": axes, "paper": kept["paper"] | {"cells": few, "decisions": small}}
    document["criteria"] = kept["criteria"] | {"R5": {"invisible": [], "visible": ["control"]}}
    again = run_sweep(read_sweep(written(document, tmp_path)))
    where = {"prior": "0.92", "token_entropy": "0.3", "replacement": "0.1", "separation": "2", "name": ""}
    rows = [row for row in csv.DictReader((KEPT / "cells.csv").open()) if where.items() <= row.items()]
    ours = list(csv.DictReader(as_csv([("", one) for one in again.grid if one.arm != "none"]).splitlines()))
    assert len(rows) == len(ours) == 4
    for before, now in zip(rows, ours, strict=True):
        for name in ("mismatch", "crossed", "threshold_mm", "flagged", "other", "gap", "predicted_gap"):
            assert float(now[name]) == pytest.approx(float(before[name]), rel=0.02, abs=0.002)
