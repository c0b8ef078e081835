"""Every table of a report, as plain cells."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dualhead_eval.effects.sites import Occupancy
from dualhead_eval.report.content import Report
from dualhead_eval.report.paper_tables import claims_table, comparisons_table, contradictions_table, sites_table
from dualhead_eval.report.table import LOSS, RHO, Cell, Column, Table, bounds, equivalence, number, with_bounds
from dualhead_eval.statistics.run_summary import FEW_PAIRS, RunSummary

_VALID = Column(
    "valid", "share of sampled pairs in which both heads reach a mode; everything to its right is about these"
)
_CAPACITY = Column(
    "C", "how much the heads could coordinate, given how varied each one is (0: one mode only, 1 - 1/K: all)"
)
_EFFECT = Column("Δ", "how much more often than chance they choose the same mode (negative: less often)")
_EQUIVALENCE = Column(
    f"{RHO} = 0?", f"whether |{RHO}| < 2% is established (two one-sided tests at 5%), and the smallest band that is"
)
_READING = Column("reading", text=True)
_SITES = (Occupancy.FLOOR, Occupancy.ORIGIN, Occupancy.INTERIOR, Occupancy.CORNER, Occupancy.NEGATIVE)


def report_tables(report: Report) -> list[Table]:
    """The tables that the report's content fills, in the order in which they are read."""
    tables: list[Table | None] = []
    if report.runs:
        tables = [effects_table(report), families_table(report), agreement_table(report)]
        tables += [residuals_table(report), residual_parts_table(report)]
    if report.loops:
        tables.append(closed_loop_table(report))
    return [table for table in tables if table is not None]


def paper_tables(report: Report) -> list[Table]:
    """The runs beside the paper's rows, and its claims on them."""
    if not report.runs:
        return []
    tables = [sites_table(report), contradictions_table(report), comparisons_table(report), claims_table(report)]
    return [table for table in tables if table is not None]


def effects_table(report: Report) -> Table:
    """The effect of every pair of heads of every run. What all share stands above it instead of in columns."""
    rows = report.run_pairs
    point: dict[str, Callable[[RunSummary], str]] = {
        "K": lambda pair: str(pair.n_modes),
        "τ": lambda pair: f"{pair.tau:g}",
        "NFE": lambda pair: str(pair.nfe),
        "heads": lambda pair: " / ".join(pair.heads),
    }
    varying = {name: cell for name, cell in point.items() if len({cell(pair) for _, pair in rows}) > 1}
    shared = [f"{name} = {cell(rows[0][1])}" for name, cell in point.items() if name not in varying]
    columns = [Column("run", text=True), *(Column(name, text=name == "heads") for name in varying)]
    columns += [_VALID, _CAPACITY, _EFFECT]
    columns.append(Column(f"{RHO} [95%]", "Δ / C: 0 independent, 1 always together; in brackets over conditions"))
    columns += [_EQUIVALENCE, LOSS, _READING, *_TRAINING]
    columns += [Column(name, meaning, detail=True) for name, meaning, _ in _DETAILS]
    lines = []
    for run, pair in rows:
        cells: list[str | Cell] = [run.name + ("*" if pair.estimator == "unbiased" else "")]
        cells += [cell(pair) for cell in varying.values()]
        cells += [number(pair.valid_rate, ".3f"), number(pair.capacity, ".4f"), number(pair.delta, "+.4f")]
        cells += [with_bounds(pair.rho, pair.intervals["rho"], "+.1%"), equivalence(pair.equivalence)]
        cells += [run.training.loss, pair.reading if pair.readable else Cell(pair.reading)]
        cells += [_known(run.training.steps), _known(run.training.seed), run.training.network_name or "-"]
        lines.append((*cells, *(cell(pair) for _, _, cell in _DETAILS)))
    notes: tuple[str, ...] = ()
    if any(pair.estimator == "unbiased" for _, pair in rows):
        notes = (f"* fewer than {FEW_PAIRS} pairs per condition: unbiased estimates, which can leave [-1, 1]",)
    return Table(
        "Do the heads choose modes together?",
        tuple(columns),
        tuple(lines),
        scope=", ".join(shared),
        notes=notes,
        legend=tuple((f"{site.word} ({site.site})", site.meaning) for site in _SITES),
    )


_TRAINING = (
    Column("steps", "training steps", detail=True),
    Column("seed", "training seed", detail=True),
    Column("network", "preconditioning, conditioning, layers x units, noise on observations, padding", True, True),
)


def _known(value: int | None) -> str:
    return "-" if value is None else f"{value}"


def _p_value(pair: RunSummary) -> str:
    shown = number(pair.adjusted_p_value, ".2g")
    return f"<= {shown}" if pair.p_value_is_bound else shown


_DETAILS: Sequence[tuple[str, str, Callable[[RunSummary], str]]] = (
    ("Δ 95%", "", lambda pair: bounds(pair.intervals["delta"], "+.4f")),
    ("obs", "observed mismatch", lambda pair: number(pair.obs, ".4f")),
    ("BL", "mismatch expected by chance", lambda pair: number(pair.bl, ".4f")),
    ("C tight", "the most that the two marginals allow", lambda pair: number(pair.capacity_tight, ".4f")),
    (
        f"p ({RHO} = 0)",
        "bootstrap p-value, adjusted over the runs (Benjamini and Hochberg); <=: no replicate beyond zero",
        _p_value,
    ),
    ("pooled Δ", "the effect of the pooled table", lambda pair: number(pair.delta_pooled, "+.4f")),
    ("Simpson", "pooled Δ less Δ: co-movement of the marginals over conditions", lambda p: number(p.simpson, "+.4f")),
    (
        "TV to data",
        "total variation between each head's modes and the data's",
        lambda pair: (
            f"{pair.tv_target_q:.3f} / {pair.tv_target_p:.3f}" if pair.tv_target_q == pair.tv_target_q else "no target"
        ),
    ),
)


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
        _READING,
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
