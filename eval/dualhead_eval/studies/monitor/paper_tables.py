"""The paper's monitor tables and claims in its own layout, on our traces and beside its numbers.

The paper's log is LIBERO-plus, whose failures are timeouts; ours are collisions, misses and drops. Its tables hold one
monitor seed, and so do ours: the first. Episode-level AUROC compares largest EWMA-max aggregates within kind and level.
"""

from __future__ import annotations

from collections.abc import Mapping

from dualhead_eval.monitor.detection.alarm_log import AlarmLog
from dualhead_eval.monitor.detection.comparison import measures
from dualhead_eval.monitor.detection.concordance import compare_scores
from dualhead_eval.monitor.detection.detection import HORIZONS, at_horizon, largest_aggregates
from dualhead_eval.paper.claims.claims import MONITOR_CLAIMS
from dualhead_eval.paper.numbers import PaperNumber, paper_numbers
from dualhead_eval.report.table import Column, Table, bounds, number, with_bounds
from dualhead_eval.statistics.interval import Interval
from dualhead_eval.studies.monitor.conclusions import Conclusions
from dualhead_eval.studies.monitor.registration import Registration
from dualhead_eval.studies.monitor.verdicts import Verdict

#: Rows: the paper's name, our arm (B the baseline, P the primary one, O the observation alone) and signal.
ROWS = (
    ("uncoordinated residual 16 sample mean", "B", "residual_mean"),
    ("uncoordinated residual", "B", "residual"),
    ("coordinated residual 16 sample mean", "P", "residual_mean"),
    ("coordinated residual", "P", "residual"),
    ("rnd", "O", "rnd"),
    ("max abs z", "O", "max_abs_z"),
    ("ace", None, None),
    ("sampling variance uncoordinated head", "B", "variance_position"),
    ("sampling variance coordinated head", "P", "variance_position"),
    ("sampling variance exec policy", None, None),
)
#: The paper's horizons in steps, in the order of ours in decisions.
PAPER_HORIZONS = (50, 75, 100, 125, 150)
NOT_SCORED = "not scored"


def paper_tables(
    step: Mapping[str, AlarmLog], episode: Mapping[str, AlarmLog], found: Conclusions, protocol: Registration
) -> list[Table]:
    """The four tables, and the paper's last four claims.

    Args:
        step: Alarm logs per decision by B, P and O; those that are missing leave their rows out.
        episode: The same per episode.
        found: What the study concludes.
        protocol: The protocol.
    """
    return [
        _episode_level(episode),
        _horizons(episode),
        _false_alarms(step),
        _capacity(found, protocol),
        _claims(step, found, protocol),
    ]


def _holds(logs: Mapping[str, AlarmLog], arm: str, signal: str) -> bool:
    return arm in logs and signal in logs[arm].signals


def _paper(source: str, row: str, quantity: str) -> PaperNumber | None:
    rows = (p for p in paper_numbers() if (p.source, p.row, p.quantity) == (source, f"libero/{row}", quantity))
    return next(rows, None)


def _printed(source: str, row: str, quantity: str, spec: str) -> str:
    found = _paper(source, row, quantity)
    if found is None:
        return "-"
    if found.value is None:
        return f"{found.low:{spec}} to {found.high:{spec}}"
    interval = None if found.low is None or found.high is None else Interval(found.low, found.high, 0.95)
    return f"{found.value:{spec}} {bounds(interval, spec)}".rstrip()


def _episode_level(logs: Mapping[str, AlarmLog]) -> Table:
    rows = []
    for name, arm, signal in ROWS:
        ours = NOT_SCORED
        if arm is not None and signal is not None and _holds(logs, arm, signal):
            log = logs[arm]
            ours = number(compare_scores(largest_aggregates(log, signal), log.success, log.strata).auroc, ".3f")
        rows.append((name, signal or "-", ours, _printed("tab:liberoplus", name, "auroc", ".3f")))
    columns = (
        Column("the paper's signal", text=True), Column("ours", text=True), Column("AUROC, ours"),
        Column("paper", "confounded with the episodes' lengths, as the paper says: there elapsed steps score .997"),
    )  # fmt: skip
    return Table("tab:liberoplus, whole episodes", columns, tuple(rows), "within kind and level; first monitor seed")


def _horizons(logs: Mapping[str, AlarmLog]) -> Table:
    rows = []
    for name, arm, signal in ROWS:
        if _paper("tab:horizons", f"{name}/K100", "auroc") is None or arm is None or signal is None:
            continue
        if not _holds(logs, arm, signal):
            continue
        cells = []
        for ours, theirs in zip(HORIZONS, PAPER_HORIZONS, strict=True):
            values, success = at_horizon(logs[arm], signal, ours)
            strata = [e.stratum for e, v in zip(logs[arm].document.episodes, logs[arm].aggregates(signal), strict=True)
                      if len(v) >= ours]  # fmt: skip
            auroc = compare_scores(values, success, strata).auroc if len(values) else float("nan")
            paper = _printed("tab:horizons", f"{name}/K{theirs}", "auroc", ".2f")
            cells.append(f"{number(auroc, '.2f')} ({success.sum()}/{(~success).sum()}) | {paper}")
        rows.append((name, *cells))
    columns = (
        Column("signal", text=True),
        *(Column(f"{a} decisions | {b} steps") for a, b in zip(HORIZONS, PAPER_HORIZONS, strict=True)),
    )
    note = "ours (successes/failures that last as long) | paper"
    return Table("tab:horizons", columns, tuple(rows), "AUROC of the aggregate so far, within kind and level", (note,))


def _false_alarms(logs: Mapping[str, AlarmLog]) -> Table:
    rows = []
    for name, arm, signal in ROWS:
        if _paper("tab:fagap", name, "false_alarm_gap") is None:
            continue
        ours = (NOT_SCORED, "-", "-")
        if arm is not None and signal is not None and _holds(logs, arm, signal):
            found = measures(logs[arm], signal, draws=1000)
            gap = with_bounds(found["gap"].value, found["gap"].interval, "+.1%")
            ours = (number(found["flagged"].value, ".1%"), number(found["other"].value, ".1%"), gap)
        paper = (
            _printed("tab:fagap", f"{name}/multimodal steps", "false_alarm_rate", ".1%"),
            _printed("tab:fagap", f"{name}/unimodal steps", "false_alarm_rate", ".1%"),
            _printed("tab:fagap", name, "false_alarm_gap", "+.1%"),
        )
        rows.append((name, *ours, *paper))
    columns = (
        Column("signal", text=True), Column("multimodal"), Column("unimodal"), Column("gap"),
        Column("paper: multimodal"), Column("unimodal "), Column("gap "),
    )  # fmt: skip
    scope = "per decision at the 95 % threshold of calibration; first monitor seed"
    return Table("tab:fagap", columns, tuple(rows), scope)


def _capacity(found: Conclusions, protocol: Registration) -> Table:
    ours = found.regimes.get(protocol.primary_arm)
    if ours is None:
        return Table("The monitored heads", (Column("quantity", text=True),), (), "the primary arm is not scored")
    source = "sec:liberoplus-coverage"
    rows = (
        ("C", number(ours.capacity, ".4f"), _printed(source, "coordinated/token partition", "C", ".4f")),
        ("effect", number(ours.delta, ".4f"), _printed(source, "coordinated/token partition", "delta", ".6f")),
        ("token entropy, nat", number(ours.entropy, ".3f"), _printed(source, "token prior", "entropy_nats", ".3f")),
        ("obedience", number(ours.obedience, ".3f"), _printed(source, "token obedience", "share", ".3f")),
    )
    columns = (Column("quantity", text=True), Column("ours, where two modes are open"), Column("paper"))
    return Table("The coordinated heads' capacity", columns, rows, f"arm {protocol.primary_arm}")


def _claims(step: Mapping[str, AlarmLog], found: Conclusions, protocol: Registration) -> Table:
    verdicts = {verdict.name: verdict for verdict in found.verdicts.get(protocol.primary_arm, [])}
    rows = [
        (MONITOR_CLAIMS[0], *_multimodality(step, found, protocol)),
        (MONITOR_CLAIMS[1], *_of(verdicts.get("P1"), better_below=True)),
        (MONITOR_CLAIMS[2], *_of(verdicts.get("P2"), better_below=False)),
        (MONITOR_CLAIMS[3], *_explanation(verdicts, found, protocol)),
    ]
    columns = (
        Column("claim", text=True),
        Column("grade", "on our traces", text=True),
        Column("evidence", text=True),
    )
    return Table("The paper's last four claims", columns, tuple(rows), "tab:claims")


def _multimodality(step: Mapping[str, AlarmLog], found: Conclusions, protocol: Registration) -> tuple[str, str]:
    gap = found.families[protocol.baseline, protocol.criteria.P1.signal]["gap"]
    evidence = f"gap {with_bounds(gap.value, gap.interval(), '+.1%')} on arm {protocol.baseline}"
    if "O" in step:
        control = measures(step["O"], "max_abs_z", draws=1000)["gap"]
        evidence += f"; control max_abs_z {with_bounds(control.value, control.interval, '+.1%')}"
    interval = gap.interval()
    return ("holds" if interval.low > 0 else "fails" if interval.high < 0 else "open"), evidence


def _of(verdict: Verdict | None, *, better_below: bool) -> tuple[str, str]:
    if verdict is None or verdict.grade == "not tested" or "seeds scored" in verdict.reason:
        return "not graded", "" if verdict is None else verdict.reason
    spec = "+.1%" if better_below else "+.3f"
    low, high = verdict.interval.low, verdict.interval.high
    improved, worse = (high < 0, low > 0) if better_below else (low > 0, high < 0)
    return (
        "holds" if improved else "fails" if worse else "open",
        f"difference {with_bounds(verdict.value, verdict.interval, spec)}",
    )


def _explanation(verdicts: Mapping[str, Verdict], found: Conclusions, protocol: Registration) -> tuple[str, str]:
    """The explanation predicts an effect where the gate is passed; one regime alone cannot tell what binds."""
    grade, evidence = _of(verdicts.get("P1"), better_below=True)
    regime = found.regimes.get(protocol.primary_arm)
    if grade == "not graded" or regime is None:
        return "not graded", evidence
    words = f"C {regime.capacity:.2f}, entropy {number(regime.entropy, '.2f')} nat: "
    if grade == "holds":
        return (
            "consistent",
            words + "with capacity and entropy the surcharge falls; which of the two binds is not varied",
        )
    return "not supported", words + "with capacity and entropy the surcharge does not fall for certain"
