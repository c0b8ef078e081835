"""Detection statistics against scikit-learn, against loops, and against what they must be by symmetry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.metrics import roc_auc_score

from dualhead_eval.monitor.detection.alarm_log import AlarmDocument, AlarmLog
from dualhead_eval.monitor.detection.comparison import differences, measures
from dualhead_eval.monitor.detection.concordance import compare_scores, compare_traces
from dualhead_eval.monitor.detection.detection import at_horizon, delays, detection_at
from dualhead_eval.monitor.detection.false_alarms import false_alarms
from dualhead_eval.report.figures.monitor import CAPTIONS, monitor_figures
from dualhead_eval.report.monitor_tables import measure_all, monitor_tables


def make_log(rng, episodes=60, *, effect=1.0, label="run", limit=1.5, aggregator="max", strata=("push@1", "slip@2")):
    """Episodes of 4 to 12 decisions; failures score higher by ``effect`` after their onset."""
    made = []
    for number in range(episodes):
        success, length = bool(rng.random() < 0.6), int(rng.integers(4, 13))
        scores = rng.standard_normal(length)
        if not success:
            scores[2:] += effect
        made.append(
            {
                "key": f"made/{number}",
                "success": success,
                "failure": "none" if success else "drop",
                "stratum": strata[number % len(strata)],
                "steps": 8 * length,
                "onset": 16,
                "at": list(range(0, 8 * length, 8)),
                "flagged": (rng.random(length) < 0.4).tolist(),
                "crossed": (rng.random(length) < 0.5).tolist(),
                "scores": {"residual": scores.tolist(), "elapsed": [8.0 * i for i in range(length)]},
            }
        )
    document = {
        "format": "dualhead-alarms/1",
        "label": label,
        "aggregator": aggregator,
        "threshold": "conformal:episode",
        "alpha": 0.05,
        "limits": {"residual": [limit], "elapsed": [40.0]},
        "provenance": {},
        "episodes": made,
    }
    return AlarmLog(AlarmDocument.model_validate(document))


@settings(deadline=None)
@given(st.integers(0, 10**6))
def test_auroc_is_scikit_learns_ties_included(seed):
    rng = np.random.default_rng(seed)
    scores, success = rng.integers(0, 6, 40).astype(float), rng.random(40) < 0.5
    success[:2] = True, False
    assert compare_scores(scores, success).auroc == pytest.approx(roc_auc_score(~success, scores))


def test_infinite_scores_tie_with_each_other_and_rank_above_all():
    assert compare_scores([np.inf, np.inf, 1.0], [True, False, True]).auroc == 0.75


def test_strata_are_compared_within_themselves_and_small_ones_named():
    rng = np.random.default_rng(0)
    strata = np.repeat(["a", "b", "c"], [40, 40, 6])
    success = rng.random(86) < 0.5
    success[80:] = True
    # The level of a stratum dominates the score, so pooling would compare strata, not episodes.
    scores = rng.standard_normal(86) - 0.8 * success + np.select([strata == "a", strata == "b"], [0.0, 50.0], 9.0)
    found = compare_scores(scores, success, strata)
    wins = pairs = 0.0
    for cell in ("a", "b"):
        here = strata == cell
        n = success[here].sum() * (~success[here]).sum()
        wins, pairs = wins + n * roc_auc_score(~success[here], scores[here]), pairs + n
    assert found.auroc == pytest.approx(wins / pairs)
    assert found.left_out == ("c",)


def test_elapsed_steps_score_one_half_exactly_where_time_is_matched():
    log = make_log(np.random.default_rng(1))
    traces = log.aggregates("elapsed")
    assert compare_traces(traces, log.success).auroc == 0.5
    assert compare_traces(traces, log.success, log.strata).auroc == 0.5
    assert compare_scores([trace[-1] for trace in traces], log.success).auroc != 0.5


def test_time_matching_compares_only_episodes_that_are_alive():
    traces = [np.array([1.0, 9.0]), np.array([2.0]), np.array([0.0, 0.0, 0.0])]
    # Failure 0 against success 1 at the first decision (loses) and against success 2 at two (wins both).
    assert compare_traces(traces, [False, True, True]).auroc == pytest.approx(2 / 3)


def test_resampling_by_weights_is_resampling_episodes():
    rng = np.random.default_rng(2)
    log = make_log(rng, episodes=30)
    traces, success = log.aggregates("residual"), log.success
    chosen = rng.integers(0, 30, 30)
    weights = np.bincount(chosen, minlength=30)[None].astype(float)
    repeated = compare_traces([traces[i] for i in chosen], success[chosen]).auroc
    assert compare_traces(traces, success).resampled(weights)[0] == pytest.approx(repeated)
    counted = false_alarms(log, "residual")
    flagged, alarms, other = 0, 0, 0
    for i in chosen:
        episode = log.document.episodes[i]
        if episode.success:
            marks = np.array(episode.flagged)
            flagged, alarms = flagged + marks.sum(), alarms + (log.exceeded("residual")[i] & marks).sum()
            other += (~marks).sum()
    assert counted.rates(weights)["flagged"][0] == pytest.approx(alarms / flagged)


def test_false_alarms_count_successes_by_flag_and_the_surcharge_is_what_two_sides_add():
    log = make_log(np.random.default_rng(3))
    rates = false_alarms(log, "residual").rates()
    rows = [
        (flag, cross, value > 1.5)
        for episode, values in zip(log.document.episodes, log.aggregates("residual"), strict=True)
        if episode.success
        for flag, cross, value in zip(episode.flagged, episode.crossed, values, strict=True)
    ]
    flagged = np.mean([alarm for flag, _, alarm in rows if flag])
    assert rates["flagged"] == pytest.approx(flagged)
    assert rates["gap"] == pytest.approx(flagged - np.mean([alarm for flag, _, alarm in rows if not flag]))
    one_sided = np.mean([alarm for flag, cross, alarm in rows if flag and not cross])
    assert rates["surcharge"] == pytest.approx(flagged - one_sided)


@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.05, 0.1, 0.5]))
def test_detection_keeps_the_realised_rate_and_no_smaller_limit_would(seed, rate):
    rng = np.random.default_rng(seed)
    largest, success = rng.integers(0, 15, 50).astype(float), rng.random(50) < 0.6
    success[:2] = True, False
    found = detection_at(largest, success, rate)
    assert found.realised == (largest[success] > found.limit).mean() <= rate
    assert found.detected == (largest[~success] > found.limit).mean()
    smaller = largest[success][largest[success] < found.limit]
    if smaller.size:
        assert (largest[success] > smaller.max()).mean() > rate


def test_delays_censor_misses_as_kaplan_and_meier_do():
    log = make_log(np.random.default_rng(4), effect=1.5)
    late = delays(log, "residual")
    steps = np.array([0.0, 8.0, 40.0])
    survival, expected = 1.0, {}
    for t in np.unique(late.steps):
        events = (late.detected & (late.steps == t)).sum()
        survival *= 1 - events / (late.steps >= t).sum()
        expected[t] = survival
    for step, share in zip(steps, late.missed_after(steps), strict=True):
        reached = [value for t, value in expected.items() if t <= step]
        assert share == pytest.approx(reached[-1] if reached else 1.0)
    assert late.lead.size == late.detected.sum()


def test_a_horizon_counts_the_episodes_that_reach_it():
    log = make_log(np.random.default_rng(5))
    values, success = at_horizon(log, "residual", 9)
    reach = [episode for episode in log.document.episodes if len(episode.at) >= 9]
    assert len(values) == len(success) == len(reach)
    assert values[0] == max(reach[0].scores["residual"][:9])


def test_two_arms_are_resampled_together():
    one, two = (make_log(np.random.default_rng(6), effect=effect, label=str(effect)) for effect in (0.0, 1.5))
    found = differences(two, one, "residual", draws=200)
    assert found["auroc"].value > 0.1
    assert found["auroc"].interval.low > 0
    apart = (
        measures(two, "residual", draws=200)["auroc"].interval,
        measures(one, "residual", draws=200)["auroc"].interval,
    )
    assert all(interval.low < interval.high for interval in apart)
    same = differences(one, one, "residual", draws=50)
    assert {measure.value for measure in same.values()} == {0.0}
    assert same["gap"].interval.low == same["gap"].interval.high == 0
    with pytest.raises(ValueError, match="different episodes"):
        differences(one, make_log(np.random.default_rng(7), episodes=10), "residual")
    with pytest.raises(ValueError, match="mixed monitors"):
        differences(one, make_log(np.random.default_rng(6), effect=0.0, aggregator="step"), "residual")


def test_the_alarm_file_gives_the_same_verdicts_and_is_checked_on_reading(tmp_path):
    log = make_log(np.random.default_rng(8))
    log.document.episodes[0].scores["residual"][0] = "diverged"
    log.write(tmp_path / "run.alarm.json")
    again = AlarmLog.read(tmp_path / "run.alarm.json")
    assert again.scores("residual")[0][0] == np.inf
    assert measures(again, "residual", draws=20) == measures(log, "residual", draws=20)
    log.write(tmp_path / "small.alarm.json.gz")
    assert AlarmLog.read(tmp_path / "small.alarm.json.gz").document == again.document
    whole = (tmp_path / "small.alarm.json.gz").read_bytes()
    assert 2 * len(whole) < (tmp_path / "run.alarm.json").stat().st_size
    (tmp_path / "small.alarm.json.gz").write_bytes(whole[:-9])
    with pytest.raises(ValueError, match="truncated or damaged"):
        AlarmLog.read(tmp_path / "small.alarm.json.gz")
    for text, message in (
        ("{", "no dualhead-alarms/1"),
        ('{"format": "dualhead-gate/1"}', "format"),
        ((tmp_path / "run.alarm.json").read_text().replace('"at":[0,', '"at":[', 1), "per decision"),
        ((tmp_path / "run.alarm.json").read_text().replace("made/1", "made/0", 1), "twice"),
    ):
        (tmp_path / "bad.alarm.json").write_text(text)
        with pytest.raises(ValueError, match=message) as error:
            AlarmLog.read(tmp_path / "bad.alarm.json")
        assert "\n" not in str(error.value)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        AlarmLog.read(tmp_path / "none.alarm.json")


def test_decisions_without_a_flag_have_no_false_alarm_rates():
    log = make_log(np.random.default_rng(9))
    for episode in log.document.episodes:
        episode.flagged = None
    with pytest.raises(ValueError, match="--flag-data"):
        false_alarms(log, "residual")
    assert "gap" not in measures(log, "residual", draws=10)


def test_the_figures_show_what_the_runs_allow():
    log = make_log(np.random.default_rng(10))
    measured = measure_all([log], draws=20)
    assert set(monitor_figures([log], measured)) == set(CAPTIONS)
    nominal = make_log(np.random.default_rng(10))
    for episode in nominal.document.episodes:
        episode.success = True
    assert set(monitor_figures([nominal], {})) == set()
    assert len(monitor_tables([log, log], measured, draws=20)) == 6
