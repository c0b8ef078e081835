"""An arm's scores under one rule: threshold fitted on the calibration episodes, alarms on the test episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualhead_eval.monitor.aggregation import running
from dualhead_eval.monitor.detection.alarm_log import AlarmDocument, AlarmLog, EpisodeEntry, stored
from dualhead_eval.monitor.thresholds.registry import make_threshold
from dualhead_eval.monitor.thresholds.threshold import Trace
from dualhead_eval.studies.monitor.arm_scores import ArmScores
from dualhead_eval.studies.monitor.log_table import MonitorLog
from dualhead_eval.studies.monitor.registration import Rule


def arm_alarms(
    log: MonitorLog,
    scores: ArmScores,
    rule: Rule,
    signals: Sequence[str],
    *,
    alpha: float,
    label: str,
    seed: int,
    learning: frozenset[int] = frozenset(),
) -> AlarmLog:
    """The alarm log of an arm's test episodes.

    Args:
        log: The log.
        scores: The arm's scores.
        rule: Aggregate and threshold.
        signals: Names of scored signals.
        alpha: Rate of false alarms that the threshold allows on calibration.
        label: Name of the run.
        seed: Of what a threshold draws (the halves of a band).
        learning: Calibration episodes that signals learned from, which thresholds leave out.
    """
    calibrating = [e for e in np.flatnonzero(log.calibrating) if e not in learning]
    limits = {}
    for name in signals:
        threshold = make_threshold(rule.threshold)
        traces = [
            Trace(running(rule.aggregator, scores.scores[name][log.rows(e)]), log.flagged[log.rows(e)])
            for e in calibrating
        ]
        threshold.fit(traces, alpha, np.random.default_rng(seed))
        limits[name] = [stored(x) for x in next(iter(threshold.learned().values()))]
    entries = []
    for e in np.flatnonzero(~log.calibrating):
        rows = log.rows(e)
        known = {name: values[e] for name, values in log.episodes.items()}
        entries.append(
            EpisodeEntry(
                key=f"{known['part']}/{known['seed']}",
                success=known["success"],
                failure=known["failure"],
                stratum=known["stratum"],
                steps=known["steps"],
                onset=known["onset"],
                at=log.step[rows].tolist(),
                flagged=log.flagged[rows].tolist(),
                crossed=scores.crossed[rows].tolist(),
                scores={name: [stored(x) for x in scores.scores[name][rows]] for name in signals},
            )
        )
    return AlarmLog(
        AlarmDocument(
            format="dualhead-alarms/1",
            label=label,
            aggregator=rule.aggregator,  # type: ignore[arg-type]
            threshold=rule.threshold,
            alpha=alpha,
            limits=limits,
            provenance={},
            episodes=entries,
        )
    )
