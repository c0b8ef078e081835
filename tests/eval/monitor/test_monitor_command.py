"""``dualhead monitor``: from recorded rollouts to a report, and what it refuses."""

import json

import pyarrow.parquet as pq
import pytest

from dualhead_eval.cli import main
from dualhead_eval.monitor.detection.alarm_log import AlarmLog


@pytest.fixture(scope="module")
def monitor(rollouts, tmp_path_factory):
    """A monitor of three signals, made by the command."""
    folder = tmp_path_factory.mktemp("monitor") / "M"
    arguments = ["monitor", "fit", str(rollouts["calibration"]), "--output", str(folder)]
    assert main([*arguments, "--signals", "residual", "variance_position", "elapsed"]) == 0
    return folder


def test_a_recording_is_scored_and_reported(monitor, rollouts, tmp_path, capsys):
    scores, page = tmp_path / "run.scores.parquet", tmp_path / "report.html"
    assert main(["monitor", "score", str(rollouts["test"]), "--monitor", str(monitor), "--output", str(scores)]) == 0
    assert (
        main(["monitor", "report", str(scores), "--output", str(page), "--alarms", str(tmp_path), "--draws", "50"]) == 0
    )
    shown = capsys.readouterr().out
    table = pq.read_table(scores).to_pandas()
    assert len(table) == 40 * 3
    # Failures disagree ten times as much: the residual finds every one, the elapsed steps none.
    assert (table.groupby("episode")["residual.alarm"].last()[~table.groupby("episode")["success"].first()]).all()
    log = AlarmLog.read(tmp_path / "run.alarm.json.gz")
    heads = log.document.provenance["heads"]
    assert heads["decisions"] == 40 * 3
    assert heads["delta"] == pytest.approx(0.5, abs=0.05)
    assert heads["capacity"] == pytest.approx(0.5, abs=0.05)
    assert log.signals == ["residual", "variance_position", "elapsed"]
    line = next(line for line in shown.splitlines() if " residual " in line)
    assert "1.000" in line
    assert "0.500" in next(line for line in shown.splitlines() if " elapsed " in line)
    assert "What the signals detect" in page.read_text()
    assert page.read_text().count("<figure>") == 2  # no onset and no flags here: ROC and one episode
    assert (tmp_path / "run.alarm.json.gz").stat().st_size < 12_000
    # The alarm file says what the scores said.
    assert main(["monitor", "report", str(tmp_path / "run.alarm.json.gz"), "--draws", "50"]) == 0
    again = capsys.readouterr().out
    assert line in again


def test_dimensions_that_never_vary_are_left_out_by_name(rollouts, tmp_path, capsys):
    arguments = ["monitor", "fit", str(rollouts["calibration"]), "--output", str(tmp_path / "M")]
    assert main([*arguments, "--signals", "max_abs_z", "--alpha", "0.1"]) == 0
    assert "hardly vary: observation.environment_state.0, " in capsys.readouterr().out


def test_another_policy_is_fitted_and_scored_on_the_same_recording(rollouts, trained, tmp_path):
    chosen = ["--policy", str(trained), "--samples", "2"]
    folder, scores = tmp_path / "M", tmp_path / "other.scores.parquet"
    arguments = ["monitor", "fit", str(rollouts["calibration"]), *chosen, "--output", str(folder)]
    assert main([*arguments, "--signals", "residual_matched"]) == 0
    assert json.loads((folder / "monitor.json").read_text())["samples"] == 2
    assert (
        main(["monitor", "score", str(rollouts["test"]), *chosen, "--monitor", str(folder), "--output", str(scores)])
        == 0
    )
    # Shared noise is another monitor, and its file says so.
    shared = [*chosen, "--source-noise-beta", "0", "--output", str(tmp_path / "shared")]
    assert main(["monitor", "fit", str(rollouts["calibration"]), *shared, "--signals", "residual_matched"]) == 0
    files = [json.loads((tmp_path / name / "monitor.json").read_text()) for name in ("M", "shared")]
    assert ["coupling" in file["provenance"] for file in files] == [False, True]
    assert files[1]["provenance"]["coupling"]["source_noise_beta"] == 0
    assert (tmp_path / "M" / "monitor.safetensors").read_bytes() != (
        tmp_path / "shared" / "monitor.safetensors"
    ).read_bytes()
    # The recording has four pairs per decision, this monitor two.
    arguments = ["monitor", "score", str(rollouts["test"]), "--monitor", str(folder), "--output", str(scores)]
    assert main([*arguments, "--overwrite"]) == 2


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["fit", "{test}", "--output", "{new}"], "12 of 40 calibration episodes failed"),
        (["fit", "{calibration}", "--output", "{new}", "--alpha", "0.01"], "expected at least 99"),
        (["fit", "{calibration}", "--output", "{new}", "--signals", "residul"], "'residul' is not known"),
        (["fit", "{calibration}", "--output", "{new}", "--signals", "vfd"], "velocity fields of two members"),
        (["fit", "{calibration}", "--output", "{new}", "--aggregator", "median"], "'median' is not known"),
        (["fit", "{calibration}", "--output", "{new}", "--threshold", "mondrian"], "--flag-data"),
        (["fit", "{calibration}", "--output", "{new}", "--samples", "2"], "--samples 2 is for --policy"),
        (["fit", "{calibration}", "--output", "{new}", "--source-noise-beta", "0"], "no policy is given"),
        (["fit", "{calibration}", "--output", "{monitor}"], "already holds"),
        (["fit", "{none}", "--output", "{new}"], "not a LeRobotDataset"),
        (["fit", "{demonstrations}", "--output", "{new}"], "not a dataset of recorded rollouts"),
        (["fit", "{calibration}", "{calibration}", "--output", "{new}"], "one name"),
        (["score", "{calibration}", "--monitor", "{monitor}", "--output", "{new}"], "shares 40 seeds"),
        (["score", "{test}", "--monitor", "{none}", "--output", "{new}"], "monitor.json does not exist"),
        (["report", "{none}"], "does not exist"),
        (["report", "{calibration}/data/chunk-000/file-000.parquet"], "holds no scores of a monitor"),
        (["report", "{calibration}/meta/info.json"], "is no dualhead-alarms/1"),
    ],
)
def test_what_cannot_be_judged_is_refused_in_one_sentence(
    arguments, sentence, rollouts, monitor, ring_data, tmp_path, capsys
):
    places = {"new": tmp_path / "new", "none": tmp_path / "none", "monitor": monitor}
    places |= {"demonstrations": ring_data / "train", **rollouts}
    assert main(["monitor", *(argument.format(**places) for argument in arguments)]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert sentence in error
    assert not (tmp_path / "new").exists()
