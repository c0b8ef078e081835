"""Alarm logs of the runs that the paper's tables hold: the first seed of two arms, and the observations alone."""

from __future__ import annotations

from dualhead_eval.monitor.detection.alarm_log import AlarmLog
from dualhead_eval.studies.monitor.arm_alarms import arm_alarms
from dualhead_eval.studies.monitor.arm_scores import ArmScores
from dualhead_eval.studies.monitor.conclusions import Scored
from dualhead_eval.studies.monitor.log_table import MonitorLog
from dualhead_eval.studies.monitor.observation_scores import FROM_CALIBRATION, learning_episodes
from dualhead_eval.studies.monitor.registration import Registration


def first_logs(
    log: MonitorLog, scored: Scored, observed: ArmScores | None, protocol: Registration
) -> tuple[dict[str, AlarmLog], dict[str, AlarmLog]]:
    """Alarm logs per decision and per episode by B (baseline), P (primary arm) and O (observations)."""
    scoring = protocol.scoring
    runs: dict[str, ArmScores] = {}
    for letter, arm in (("B", protocol.baseline), ("P", protocol.primary_arm)):
        if arm in scored:
            runs[letter] = next(iter(scored[arm].values()))
    if observed is not None:
        runs["O"] = observed
    made: list[dict[str, AlarmLog]] = []
    for rule in (scoring.step, scoring.episode):
        logs = {}
        for letter, scores in runs.items():
            learned = any(name in FROM_CALIBRATION for name in scores.scores)
            logs[letter] = arm_alarms(
                log, scores, rule, list(scores.scores), alpha=scoring.alpha, label=letter,
                seed=protocol.inference.seed, learning=learning_episodes(log, scoring.seed) if learned else frozenset(),
            )  # fmt: skip
        made.append(logs)
    return made[0], made[1]
