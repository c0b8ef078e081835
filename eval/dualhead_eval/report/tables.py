"""Every table of a report, as plain cells."""

from __future__ import annotations

from dualhead_eval.ensembles.summary import is_ensemble
from dualhead_eval.evaluation.rollouts import wilson_interval
from dualhead_eval.report.content import Report
from dualhead_eval.report.effects_table import effects_table
from dualhead_eval.report.ensemble_tables import contamination_table, ensemble_choices_table
from dualhead_eval.report.paper_tables import claims_table, comparisons_table, contradictions_table, sites_table
from dualhead_eval.report.table import LOSS, READING, RHO, Column, Table, equivalence, number, with_bounds


def report_tables(report: Report) -> list[Table]:
    """The tables that the report's content fills, in the order in which they are read."""
    tables: list[Table | None] = []
    if report.runs:
        tables = [effects_table(report), families_table(report), agreement_table(report)]
        tables += [residuals_table(report), residual_parts_table(report), *_ensemble_tables(report)]
    if report.loops:
        tables += [closed_loop_table(report), closed_loop_modes_table(report)]
    return [table for table in tables if table is not None]


def _ensemble_tables(report: Report) -> list[Table]:
    gates = [run.gate for run in report.runs if is_ensemble(run.gate)]
    return [ensemble_choices_table(gates), contamination_table(gates)] if gates else []


def paper_tables(report: Report) -> list[Table]:
    """The runs beside the paper's rows, and its claims on them."""
    if not report.runs:
        return []
    tables = [sites_table(report), contradictions_table(report), comparisons_table(report), claims_table(report)]
    return [table for table in tables if table is not None]


def families_table(report: Report) -> Table | None:
    """Means over seeds, the seed being the unit; None if no two runs are seeds of one mechanism."""
    if not report.families:
        return None
    columns = (
        Column("family", text=True),
        Column("seeds"),
        Column("valid"),
        Column("C"),
        Column("Δ"),
        Column("sd of Δ", detail=True),
        Column(f"{RHO} [95%]", "mean over seeds; in brackets Student's t interval over seeds"),
        Column("sd", f"of {RHO} between seeds"),
        Column(f"{RHO} = 0?"),
        LOSS,
        READING,
    )
    lines = []
    for family in report.families:
        mean = family.mean
        lines.append(
            (
                family.label,
                f"{len(family.runs)} ({', '.join(map(str, family.seeds))})",
                number(mean["valid_rate"], ".3f"),
                number(mean["capacity"], ".4f"),
                number(mean["delta"], "+.4f"),
                number(family.sd["delta"], ".4f"),
                with_bounds(mean["rho"], family.rho_interval, "+.1%"),
                number(family.sd["rho"], ".1%"),
                equivalence(family.equivalence),
                family.loss,
                f"{family.occupancy.word} ({family.occupancy.site})",
            )
        )
    return Table("Means over seeds (the seed is the unit)", columns, tuple(lines))


def agreement_table(report: Report) -> Table | None:
    """Runs with a third head: do all heads choose one mode? None without such a run."""
    lines = []
    for run in report.runs:
        if run.agreement is None:
            continue
        a = run.agreement
        cells = [run.name, ", ".join(run.gate.heads), number(a.valid_rate, ".3f")]
        lines.append((*cells, with_bounds(a.rate, a.interval, ".3f"), number(a.chance, ".3f")))
    columns = (
        Column("run", text=True),
        Column("heads", text=True),
        Column("all valid"),
        Column("in one mode [95%]"),
        Column("by chance", "if each head kept its own marginals and chose independently"),
    )
    return Table("All heads at once", columns, tuple(lines)) if lines else None


_RESIDUAL = (
    Column("run", text=True),
    Column("residual", text=True),
    Column("unit", text=True),
    Column("mean"),
    Column("same-mode", "of pairs in one mode: the floor that coordination cannot lower"),
    Column("cross-mode", "of pairs in two modes"),
    Column("cross share", "of the residual's sum that cross-mode pairs contribute"),
    Column("mean / floor"),
    Column("AUROC", "of the residual as a detector of cross-mode pairs, within conditions"),
)


def residuals_table(report: Report) -> Table | None:
    """How far apart the two decodings are, by stratum; None if no gate holds residuals."""
    return _residuals(report, "The residual between the two decodings", parts=False)


def residual_parts_table(report: Report) -> Table | None:
    """The residual split along and across the direction that separates the modes; None without such parts."""
    return _residuals(report, "The residual along and across the modes' separation", parts=True)


def _residuals(report: Report, title: str, *, parts: bool) -> Table | None:
    lines = []
    for run in report.runs:
        if is_ensemble(run.gate):  # its scores have tables of their own
            continue
        for component, s in run.residuals.items():
            if ("/" in component) is parts:
                means = (number(value, ".2f") for value in (s.mean, s.same, s.cross))
                cells = (number(s.cross_share, ".1%"), number(s.over_floor, ".2f"), number(s.auroc, ".4f"))
                lines.append((run.name, component, s.unit, *means, *cells))
    return Table(title, _RESIDUAL, tuple(lines), every_quantity=parts) if lines else None


def closed_loop_table(report: Report) -> Table:
    """What became of recorded episodes."""
    lines = []
    for name, loop in report.loops:
        success = with_bounds(loop.success_rate, loop.success_interval, ".1%")
        collision = f"{loop.collisions / loop.episodes:.1%}"
        refused = str(len(loop.refusals))
        lines.append((name, loop.env_id, loop.control, str(loop.episodes), success, collision, refused))
    columns = (
        Column("run", text=True),
        Column("environment", text=True),
        Column("driving", "the head whose chunks the robot executes", text=True),
        Column("episodes"),
        Column("success [95%]", "in brackets Wilson's interval"),
        Column("collision"),
        Column("refused", "episodes that ended because a decision was refused; they count as failures"),
    )
    return Table(
        "Closed loop", columns, tuple(lines), notes=("Outcomes of episodes: no threshold and no NFE enters them.",)
    )


def closed_loop_modes_table(report: Report) -> Table | None:
    """Which way recorded episodes took, and what became of them; None if no loop says."""
    lines = []
    for name, loop in report.loops:
        for outcome in loop.modes:
            share = outcome.episodes / loop.episodes
            taken = with_bounds(share, wilson_interval(outcome.episodes, loop.episodes), ".1%")
            rate = outcome.successes / outcome.episodes if outcome.episodes else float("nan")
            success = with_bounds(rate, outcome.success_interval, ".1%")
            mode = "none" if outcome.mode < 0 else str(outcome.mode)
            lines.append((name, loop.control, mode, str(outcome.episodes), taken, success))
    columns = (
        Column("run", text=True),
        Column("driving", text=True),
        Column("mode", "of the episode's whole path; none: it reached no mode", text=True),
        Column("episodes"),
        Column("share [95%]", "of all episodes of the run"),
        Column("success [95%]", "of the episodes of this mode; both with Wilson's interval"),
    )
    return Table("Closed loop, mode by mode", columns, tuple(lines)) if lines else None
