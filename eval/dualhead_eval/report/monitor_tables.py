"""Tables of a monitor report, as plain cells for a terminal or a page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from dualhead_eval.monitor.detection.alarm_log import AlarmLog
from dualhead_eval.monitor.detection.comparison import Measure, differences, measures, require_one_monitor
from dualhead_eval.monitor.detection.concordance import FEWEST, compare_scores
from dualhead_eval.monitor.detection.detection import HORIZONS, at_horizon, delays
from dualhead_eval.report.table import Cell, Column, Table, number, with_bounds
from dualhead_eval.statistics.bootstrap import BOOTSTRAP_DRAWS

#: Columns of the main table: measure, heading, meaning.
_MEASURES = (
    (
        "auroc",
        "AUROC",
        "chance that a failure ranks above a success of its own perturbation and level at the same time",
    ),
    ("auroc_time_matched", "AUROC, any level", "the same between all failures and successes"),
    ("auroc_whole", "whole log", "between largest aggregates of whole episodes, time and level ignored"),
    ("flagged", "false alarms, flagged", "share of successes' decisions with an alarm where two modes are open"),
    ("other", "elsewhere", "the same where one mode is open"),
    ("gap", "gap", "their difference"),
    ("surcharge", "surcharge", "the part of it that pairs on two sides add"),
    ("detected_5", "detected at 5 %", "share of failures detected while at most 5 % of the successes raise an alarm"),
    ("detected_10", "at 10 %", "the same at 10 %"),
)
_RUN_AND_SIGNAL = (Column("run", text=True), Column("signal", text=True))
#: Measures that are differences themselves.
_SIGNED = ("gap", "surcharge")
_AUROC = ("auroc", "auroc_time_matched", "auroc_whole")


#: Measures by run and signal.
Measured = dict[tuple[str, str], dict[str, Measure]]


def measure_all(logs: Sequence[AlarmLog], *, draws: int = BOOTSTRAP_DRAWS) -> Measured:
    """The measures of every signal of every run."""
    return {(log.label, signal): measures(log, signal, draws=draws) for log in logs for signal in log.signals}


def monitor_tables(logs: Sequence[AlarmLog], measured: Measured, *, draws: int = BOOTSTRAP_DRAWS) -> list[Table]:
    """Every table about these runs, in the order in which they are read.

    Raises:
        ValueError: If the runs were scored by monitors that aggregate or calibrate differently.
    """
    require_one_monitor(logs)
    tables = [_episodes(logs), _heads(logs), _signals(logs, measured, draws), _horizons(logs), _delays(logs)]
    if len(logs) > 1:
        tables.append(_differences(logs, draws))
    return tables


def _episodes(logs: Sequence[AlarmLog]) -> Table:
    rows: list[tuple[str | Cell, ...]] = []
    for log in logs:
        for stratum in sorted(set(log.strata.tolist())):
            here = [episode for episode in log.document.episodes if episode.stratum == stratum]
            failures = [episode.failure for episode in here if not episode.success]
            kinds = ", ".join(f"{count} {kind}" for kind, count in Counter(failures).most_common())
            compared = min(len(failures), len(here) - len(failures)) >= FEWEST
            few = "yes" if compared else Cell(f"no: fewer than {FEWEST}")
            rows.append((log.label, stratum, str(len(here) - len(failures)), str(len(failures)), kinds or "-", few))
    columns = (
        Column("run", text=True),
        Column("perturbation", text=True),
        Column("successes"),
        Column("failures"),
        Column("of them", text=True),
        Column("compared", f"whether the stratum has {FEWEST} of both, which AUROC needs", text=True),
    )
    return Table("The episodes", columns, tuple(rows))


def _heads(logs: Sequence[AlarmLog]) -> Table:
    rows: list[tuple[str | Cell, ...]] = []
    for log in logs:
        heads = log.document.provenance.get("heads")
        if not isinstance(heads, dict):
            continue
        numbers = (number(heads.get(name), ".3f") for name in ("valid_rate", "delta", "capacity", "rho"))
        low, high = heads.get("capacity_bounds", (float("nan"),) * 2)
        rows.append(
            (log.label, str(heads.get("decisions")), *numbers, f"[{low:.3f},{high:.3f}]", str(heads.get("verdict")))
        )
    columns = (
        Column("run", text=True),
        Column("decisions"),
        Column("valid"),
        Column("\N{GREEK CAPITAL LETTER DELTA}"),
        Column("C", "how much the heads could coordinate; without it no monitor can be blamed for their disagreement"),
        Column("\N{GREEK SMALL LETTER RHO}"),
        Column("C at all times", "bounds that hold jointly and at all times with probability 95 %"),
        Column("verdict", text=True),
    )
    scope = "certificate over the decisions at which two modes are open, or over all without --flag-data"
    return Table("The monitored heads", columns, tuple(rows), scope)


def _signals(logs: Sequence[AlarmLog], measured: Measured, draws: int) -> Table:
    rows: list[tuple[str | Cell, ...]] = []
    for log in logs:
        for signal in log.signals:
            found = measured[log.label, signal]
            rows.append((log.label, signal, *(_cell(found.get(name), name) for name, _, _ in _MEASURES)))
    flagged = all(episode.flagged is not None for log in logs for episode in log.document.episodes)
    notes = [f"95 % intervals over episodes, {draws} bootstrap draws"]
    if not flagged:
        notes.append("no false alarms by flag: score with --flag-data to know where two modes are open")
    columns = (*_RUN_AND_SIGNAL, *(Column(heading, meaning) for _, heading, meaning in _MEASURES))
    return Table("What the signals detect", columns, tuple(rows), _scope(logs), tuple(notes))


def _horizons(logs: Sequence[AlarmLog]) -> Table:
    rows = []
    for log in logs:
        for signal in log.signals:
            cells = []
            for horizon in HORIZONS:
                values, success = at_horizon(log, signal, horizon)
                auroc = compare_scores(values, success).auroc if len(values) else float("nan")
                cells.append(f"{number(auroc, '.3f')} ({success.sum()}/{(~success).sum()})")
            rows.append((log.label, signal, *cells))
    columns = (*_RUN_AND_SIGNAL, *(Column(f"{horizon} decisions") for horizon in HORIZONS))
    note = "AUROC of the aggregate after so many decisions; in brackets successes and failures that make as many"
    return Table("How early", columns, tuple(rows), _scope(logs), (note,))


def _delays(logs: Sequence[AlarmLog]) -> Table:
    rows = []
    for log in logs:
        for signal in log.signals:
            late = delays(log, signal)
            if not late.steps.size:
                continue
            lead = sorted(late.lead)[len(late.lead) // 2] if late.lead.size else float("nan")
            missed = late.missed_after(np.array([10.0, 40.0]))
            rows.append(
                (
                    log.label,
                    signal,
                    str(late.steps.size),
                    f"{late.detected.mean():.1%}",
                    *(f"{1 - share:.1%}" for share in missed),
                    number(lead, ".0f"),
                    str(late.early),
                )
            )
    columns = (
        *_RUN_AND_SIGNAL,
        Column("failures", "failures whose perturbation has an onset"),
        Column("detected", "share with an alarm at or after the onset, under the fitted threshold"),
        Column("within 10 steps", "Kaplan-Meier estimate, misses censored at the episode's end"),
        Column("within 40 steps"),
        Column("median lead", "steps from the alarm to the end of the episode, of the detected"),
        Column("early", "failures with an alarm before the onset"),
    )
    note = () if rows else ("no failure has an onset: delays need perturbations that set in during the episode",)
    return Table("How late", columns, tuple(rows), _scope(logs), note)


def _differences(logs: Sequence[AlarmLog], draws: int) -> Table:
    first, rows, notes = logs[0], [], []
    for log in logs[1:]:
        for signal in [name for name in log.signals if name in first.signals]:
            try:
                found = differences(log, first, signal, draws=draws)
            except ValueError as error:
                notes.append(str(error))
                break
            rows.append(
                (
                    f"{log.label} - {first.label}",
                    signal,
                    *(_cell(found.get(n), n, difference=True) for n, _, _ in _MEASURES),
                )
            )
    columns = (*_RUN_AND_SIGNAL, *(Column(heading) for _, heading, _ in _MEASURES))
    return Table("Between runs on the same episodes", columns, tuple(rows), "resampled together", tuple(notes))


def _scope(logs: Sequence[AlarmLog]) -> str:
    aggregators = sorted({log.document.aggregator for log in logs})
    thresholds = sorted({f"{log.document.threshold} at {log.document.alpha:g}" for log in logs})
    return f"aggregate {', '.join(aggregators)}; threshold {', '.join(thresholds)}"


def _cell(measure: Measure | None, name: str, *, difference: bool = False) -> str:
    if measure is None:
        return "-"
    sign = "+" if difference or name in _SIGNED else ""
    return with_bounds(measure.value, measure.interval, f"{sign}.3f" if name in _AUROC else f"{sign}.1%")
