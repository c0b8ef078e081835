"""The tables of the monitor study, as plain cells for a terminal or a page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np

from dualhead_eval.monitor.detection.concordance import FEWEST
from dualhead_eval.report.table import Cell, Column, Table, number, with_bounds
from dualhead_eval.studies.monitor.conclusions import Conclusions
from dualhead_eval.studies.monitor.families import FamilyMeasure, holm
from dualhead_eval.studies.monitor.log_table import MonitorLog
from dualhead_eval.studies.monitor.registration import Registration, registered_resampled
from dualhead_eval.studies.monitor.verdicts import Verdict

_DELTA = "\N{GREEK CAPITAL LETTER DELTA}"
#: Columns of the arms' table: measure, heading, meaning, format.
_MEASURES = (
    ("flagged", "false alarms, flagged", "share of successes' decisions with an alarm where two modes are open", ".1%"),
    ("other", "elsewhere", "the same where one mode is open", ".1%"),
    ("gap", "gap", "their difference", "+.1%"),
    ("surcharge", "surcharge", "the part of the flagged rate that pairs on two sides add", "+.1%"),
    ("auroc", "AUROC", "failures against successes of their own kind and level, at the same decision", ".3f"),
    ("auroc_time_matched", "any level", "the same between all failures and successes", ".3f"),
    ("auroc_whole", "whole log", "largest aggregates of whole episodes, time and level ignored", ".3f"),
    (
        "detected_5",
        "detected at 5 %",
        "failures detected while 5 % of the successful test episodes raise an alarm",
        ".1%",
    ),
)


def study_tables(
    log: MonitorLog, found: Conclusions, protocol: Registration, beside: Mapping[str, Conclusions] | None = None
) -> list[Table]:
    """Every table, in the order in which they are read; ``beside``: conclusions of the other environments, by name."""
    return [
        _verdicts(found, protocol, beside or {}),
        _regimes(found, protocol),
        _arms(found, protocol),
        _rivals(found),
        _episodes(log),
    ]


def _verdicts(found: Conclusions, protocol: Registration, beside: Mapping[str, Conclusions]) -> Table:
    rows: list[tuple[str | Cell, ...]] = []
    claims = {protocol.primary_arm, *registered_resampled().claims}
    for arm, verdicts in found.verdicts.items():
        for verdict in verdicts:
            spec = "+.3f" if "AUROC" in verdict.measure else "+.1%"
            grade: str | Cell = verdict.grade if verdict.grade != "not tested" else Cell(verdict.grade)
            rows.append(
                (
                    f"{arm} - {protocol.baseline}" + ("" if arm in claims else " (no claim)"),
                    verdict.name,
                    verdict.measure,
                    with_bounds(verdict.value, verdict.interval, spec),
                    number(verdict.p_value, ".4f"),
                    grade,
                    verdict.reason,
                )
            )
    columns = (
        Column("arms", text=True),
        Column("criterion", text=True),
        Column("measure", text=True),
        Column("difference", "with its 95 % interval (S2: 90 %) over training seeds and episodes"),
        Column("p", "one sided, of P1 and P2"),
        Column("grade", text=True),
        Column("why", text=True),
    )
    return Table(
        "The registered criteria",
        columns,
        tuple(rows),
        "docs/monitor_registration.md",
        practical_value({"this environment": found, **beside}, protocol),
    )


def practical_value(found: Mapping[str, Conclusions], protocol: Registration) -> tuple[str, ...]:
    """Whether P1 and P2 hold together, by Holm's rule over the protocol's environments; a line for each that is given.

    An environment that is not at hand counts as not rejected: the others are then tested at the stricter levels.
    """
    lines, p_values, met = {}, {}, {}
    for name, conclusions in found.items():
        verdicts = {verdict.name: verdict for verdict in conclusions.verdicts.get(protocol.primary_arm, [])}
        if not verdicts:
            lines[name] = f"arm {protocol.primary_arm} is not scored, nothing is decided"
            continue
        grades = {verdicts["P1"].grade, verdicts["P2"].grade}
        if "not tested" in grades or any("seeds scored" in v.reason for v in verdicts.values()):
            lines[name] = grades.pop()
            continue
        p_values[name] = max(_p(verdicts["P1"]), _p(verdicts["P2"]))
        met[name] = grades == {"met"}
    planned = len(protocol.environments)
    rejected = holm(p_values, protocol.scoring.alpha, planned)
    for rank, name in enumerate(rejected):
        word = "established" if rejected[name] and met[name] else "not established"
        level = protocol.scoring.alpha / (planned - rank)
        lines[name] = f"{word}, p = {p_values[name]:.4f} against {level:g}"
    return tuple(f"practical value of coordination (P1 and P2 together), {name}: {lines[name]}" for name in found)


def _p(verdict: Verdict) -> float:
    return 1.0 if verdict.p_value is None else verdict.p_value


def _regimes(found: Conclusions, protocol: Registration) -> Table:
    gate = protocol.gate
    rows: list[tuple[str | Cell, ...]] = []
    for arm, regime in found.regimes.items():
        missed = regime.missed(gate)
        rows.append(
            (
                arm,
                ", ".join(map(str, found.seeds[arm])),
                str(regime.decisions),
                number(regime.valid, ".3f"),
                number(regime.delta, "+.3f"),
                number(regime.capacity, ".3f"),
                number(regime.delta / regime.capacity if regime.capacity else None, "+.2f"),
                number(regime.entropy, ".3f"),
                number(regime.obedience, ".3f"),
                Cell("; ".join(missed)) if missed else "passed",
            )
        )
    columns = (
        Column("arm", text=True),
        Column("seeds", text=True),
        Column("decisions", "flagged decisions of nominal test episodes"),
        Column("valid", "pairs in which both heads reach a mode"),
        Column(_DELTA),
        Column("C", f"capacity, at least {gate.capacity:g}"),
        Column("\N{GREEK SMALL LETTER RHO}"),
        Column("token entropy", f"of the prior, in nat, at least {gate.token_entropy_nat:g}"),
        Column("obedience", f"valid chunks on their token's side, at least {gate.obedience:g}"),
        Column("gate", text=True),
    )
    return Table("The regime gate", columns, tuple(rows), "means over training seeds")


def _arms(found: Conclusions, protocol: Registration) -> Table:
    rows = []
    for (arm, signal), measures in found.families.items():
        rows.append((arm, signal, *(_cell(measures[name], spec) for name, _, _, spec in _MEASURES)))
    columns = (
        Column("arm", text=True),
        Column("signal", text=True),
        *(Column(heading, meaning) for _, heading, meaning, _ in _MEASURES),
    )
    scoring = protocol.scoring
    scope = (
        f"false alarms under {scoring.step.threshold} at {scoring.alpha:.0%}, the rest by "
        f"{scoring.episode.aggregator}; means over seeds, 95 % intervals over seeds and episodes"
    )
    return Table("What the arms' signals detect", columns, tuple(rows), scope)


def _rivals(found: Conclusions) -> Table:
    rows = []
    for (arm, threshold), measures in found.rivals.items():
        names = (("gap", "+.1%"), ("surcharge", "+.1%"), ("false_episodes", ".1%"), ("detected", ".1%"))
        rows.append((arm, threshold, *(_cell(measures[name], spec) for name, spec in names)))
    columns = (
        Column("arm", text=True),
        Column("threshold", text=True),
        Column("gap"),
        Column("surcharge"),
        Column("episodes, false", "successful test episodes with an alarm at any time, under the fitted threshold"),
        Column("detected", "failed ones"),
    )
    note = (
        "paper-step thresholds compare the score itself, the others the EWMA-max; Mondrian and band know flag or time"
    )
    return Table("Thresholds instead of coordination", columns, tuple(rows), "residual", (note,))


def _episodes(log: MonitorLog) -> Table:
    rows: list[tuple[str | Cell, ...]] = []
    test = ~log.calibrating
    strata, success = np.array(log.episodes["stratum"]), np.array(log.episodes["success"])
    failure = np.array(log.episodes["failure"])
    for stratum in sorted(set(strata[test].tolist()), key=lambda name: (name != "nominal", name)):
        here = test & (strata == stratum)
        won, lost = int((here & success).sum()), int((here & ~success).sum())
        kinds = Counter(failure[here & ~success].tolist())
        words = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
        few: str | Cell = "yes" if min(won, lost) >= FEWEST else Cell(f"no: fewer than {FEWEST}")
        rows.append((stratum, str(won), str(lost), words or "-", few))
    rows.append(("all", str(int((test & success).sum())), str(int((test & ~success).sum())), "", ""))
    columns = (
        Column("perturbation", text=True),
        Column("successes"),
        Column("failures"),
        Column("of them", text=True),
        Column("compared", "whether the stratum has enough of both for the stratified AUROC", text=True),
    )
    rows_of_test = test[log.episode]
    notes = (
        f"{int(log.calibrating.sum())} nominal successes calibrate; {int(rows_of_test.sum())} test decisions, of which "
        f"{log.flagged[rows_of_test].mean():.1%} are flagged",
    )
    return Table("The log", columns, tuple(rows), "test episodes", notes)


def _cell(measure: FamilyMeasure, spec: str) -> str:
    return with_bounds(measure.value, measure.interval(), spec)
