"""Everything that follows from a log and the arms' scores on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from dualhead_eval.monitor.detection.alarm_log import AlarmLog
from dualhead_eval.monitor.detection.comparison import replicates
from dualhead_eval.studies.monitor.arm_alarms import arm_alarms
from dualhead_eval.studies.monitor.arm_scores import ArmScores
from dualhead_eval.studies.monitor.families import Families, FamilyMeasure, RunMeasures
from dualhead_eval.studies.monitor.log_table import MonitorLog
from dualhead_eval.studies.monitor.regime import Regime, mean_regime, regime
from dualhead_eval.studies.monitor.registration import LaterCriteria, Registration, Rule
from dualhead_eval.studies.monitor.verdicts import (
    NOT_DECIDED,
    NOT_TESTED,
    Verdict,
    grade_detection,
    grade_distribution_rival,
    grade_false_alarms,
    grade_rival,
    report_beside_primary,
    report_difference,
)

#: Scores of every arm by training seed.
Scored = Mapping[str, Mapping[int, ArmScores]]


@dataclass(frozen=True)
class Conclusions:
    """What the study says.

    Attributes:
        seeds: Training seeds scored, by arm.
        planned: Training seeds that the protocol asks for.
        regimes: Mean regime by arm.
        families: Measures by arm and signal, over the arm's seeds.
        rivals: Measures of the criteria's signal by arm and threshold: the baseline's under thresholds that need no
            coordination, and every arm's under the registered ones.
        verdicts: Graded criteria by arm; claims are those of the primary arm and of resampled ones that are said to be.
        alarms: Alarm logs of the first seed of every arm, per episode, for figures.
    """

    seeds: dict[str, list[int]]
    planned: list[int]
    regimes: dict[str, Regime]
    families: dict[tuple[str, str], dict[str, FamilyMeasure]]
    rivals: dict[tuple[str, str], dict[str, FamilyMeasure]]
    verdicts: dict[str, list[Verdict]]
    alarms: dict[str, AlarmLog]


def conclude(
    log: MonitorLog, scored: Scored, protocol: Registration, planned: list[int], later: LaterCriteria | None = None
) -> Conclusions:
    """Measure and grade.

    Args:
        log: The log.
        scored: The arms' scores.
        protocol: The registered protocol.
        planned: Training seeds of every arm.
        later: What was registered later for this environment.

    Raises:
        ValueError: If the baseline has no scores, or the thresholds have too few calibration episodes.
    """
    if protocol.baseline not in scored:
        raise ValueError(f"arm {protocol.baseline} has no scores, expected the baseline's: train and score it first")
    scoring = protocol.scoring
    held = [set(scores.scores) for by_seed in scored.values() for scores in by_seed.values()]
    signals = [name for name in scoring.signals if all(name in own for own in held)]
    families = Families(int((~log.calibrating).sum()), protocol.inference.draws, protocol.inference.seed)

    def alarms(arm: str, seed: int, rule: Rule) -> AlarmLog:
        return arm_alarms(
            log, scored[arm][seed], rule, signals, alpha=scoring.alpha, label=arm, seed=protocol.inference.seed
        )

    runs: dict[tuple[str, int, str], RunMeasures] = {}
    first: dict[str, AlarmLog] = {}
    for arm, by_seed in scored.items():
        for seed in by_seed:
            step, episode = alarms(arm, seed, scoring.step), alarms(arm, seed, scoring.episode)
            first.setdefault(arm, episode)
            for signal in signals:
                runs[arm, seed, signal] = families.run(step, episode, signal)
    measured = {
        (arm, signal): families.family([runs[arm, seed, signal] for seed in by_seed])
        for arm, by_seed in scored.items()
        for signal in signals
    }
    regimes = {
        arm: mean_regime([regime(log, scores, scoring.samples) for scores in by_seed.values()])
        for arm, by_seed in scored.items()
    }
    verdicts = {}
    for arm in scored:
        common = [seed for seed in scored[arm] if seed in scored[protocol.baseline]]
        if arm != protocol.baseline and common:
            found = _grade(arm, common, runs, families, protocol, later)
            verdicts[arm] = _qualified(found, arm, common, planned, regimes, protocol)
    return Conclusions(
        {arm: list(by_seed) for arm, by_seed in scored.items()},
        planned,
        regimes,
        measured,
        _rivals(log, scored, protocol, families),
        verdicts,
        first,
    )


def _grade(
    arm: str, seeds: list[int], runs: Mapping[tuple[str, int, str], RunMeasures], families: Families,
    protocol: Registration, later: LaterCriteria | None,
) -> list[Verdict]:  # fmt: skip
    def family(of: str, signal: str) -> dict[str, FamilyMeasure]:
        return families.family([runs[of, seed, signal] for seed in seeds])

    criteria, base = protocol.criteria, protocol.baseline
    ours, theirs = family(arm, criteria.P1.signal), family(base, criteria.P1.signal)
    rival = family(base, criteria.S2.signal)
    added: list[Verdict] = []
    if later is not None:
        rule = later.S5
        added = grade_distribution_rival(family(arm, rule.against), family(base, rule.signal), rule)
    primary = protocol.primary_arm
    if arm not in protocol.arms and all((primary, seed, criteria.P1.signal) in runs for seed in seeds):
        added += report_beside_primary(primary, ours, family(primary, criteria.P1.signal))
    return [
        grade_false_alarms(ours[criteria.P1.measure], theirs[criteria.P1.measure], criteria),
        grade_detection(ours[criteria.P2.measure], theirs[criteria.P2.measure], criteria),
        report_difference("S1", "failures detected at 5 % false episodes", ours[criteria.S1.measure],
                          theirs[criteria.S1.measure]),
        grade_rival(family(arm, criteria.S2.against)[criteria.S2.measure], rival[criteria.S2.measure], criteria),
        report_difference("S4", "mismatch surcharge", ours[criteria.S4.measure], theirs[criteria.S4.measure]),
        *added,
    ]  # fmt: skip


def _qualified(
    verdicts: list[Verdict], arm: str, seeds: list[int], planned: list[int], regimes: Mapping[str, Regime],
    protocol: Registration,
) -> list[Verdict]:  # fmt: skip
    """The verdicts as the gate and the number of seeds allow them."""
    missed = [f"{name}: {why}" for name in (protocol.baseline, arm) for why in regimes[name].missed(protocol.gate)]
    if missed:
        return [
            replace(v, grade=NOT_TESTED, reason=f"{v.reason}; gate missed by {'; '.join(missed)}") for v in verdicts
        ]
    if len(seeds) < len(planned):
        few = f"{len(seeds)} of {len(planned)} seeds scored so far"
        return [replace(v, grade=NOT_DECIDED, reason=f"{v.reason}; {few}, so far {v.grade}") for v in verdicts]
    return verdicts


def _rivals(
    log: MonitorLog, scored: Scored, protocol: Registration, families: Families
) -> dict[tuple[str, str], dict[str, FamilyMeasure]]:
    """Alarms of the criteria's signal: every arm's under the registered thresholds, the baseline's under S3's too."""
    scoring, signal = protocol.scoring, protocol.criteria.P1.signal
    plain = [scoring.step.threshold, scoring.episode.threshold]
    found = {}
    for arm, by_seed in scored.items():
        for threshold in [*plain, *(protocol.criteria.S3.thresholds if arm == protocol.baseline else [])]:
            per_step = threshold.endswith("paper-step")
            rule = Rule(
                aggregator=scoring.step.aggregator if per_step else scoring.episode.aggregator, threshold=threshold
            )
            measures: list[RunMeasures] = []
            for scores in by_seed.values():
                alarms = arm_alarms(
                    log, scores, rule, [signal], alpha=scoring.alpha, label=arm, seed=protocol.inference.seed
                )
                measures.append(_shares(families, alarms, signal))
            found[arm, threshold] = families.family(measures)
    return found


def _shares(families: Families, alarms: AlarmLog, signal: str) -> RunMeasures:
    values, drawn = replicates(alarms, signal, families.weights, ("false_alarms",))
    shares = families.alarm_shares(alarms, signal)
    return {**values, **shares[0]}, {**drawn, **shares[1]}
