"""The table of effects: every pair of heads of every run, with everything that reading it takes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dualhead_eval.effects.sites import Occupancy
from dualhead_eval.gate.gate import LABEL_TABLE
from dualhead_eval.report.content import Report
from dualhead_eval.report.table import LOSS, READING, RHO, Cell, Column, Table, bounds, equivalence, number, with_bounds
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
_SITES = (Occupancy.FLOOR, Occupancy.ORIGIN, Occupancy.INTERIOR, Occupancy.CORNER, Occupancy.NEGATIVE)


def effects_table(report: Report) -> Table:
    """The effect of every pair of heads of every run. What all share stands above it instead of in columns."""
    rows = report.run_pairs
    point: dict[str, Callable[[RunSummary], str]] = {
        "K": lambda pair: str(pair.n_modes),
        "τ": lambda pair: f"{pair.tau:g}",
        "NFE": lambda pair: str(pair.nfe),
        "heads": lambda pair: " / ".join(pair.heads),
    }
    if all(run.gate.provenance.get("method") == LABEL_TABLE for run, _ in rows):
        # Labels were given as they are: nothing was thresholded or integrated.
        del point["τ"], point["NFE"]
    varying = {name: cell for name, cell in point.items() if len({cell(pair) for _, pair in rows}) > 1}
    shared = [f"{name} = {cell(rows[0][1])}" for name, cell in point.items() if name not in varying]
    columns = [Column("run", text=True), *(Column(name, text=name == "heads") for name in varying)]
    columns += [_VALID, _CAPACITY, _EFFECT]
    columns.append(Column(f"{RHO} [95%]", "Δ / C: 0 independent, 1 always together; in brackets over conditions"))
    columns += [_EQUIVALENCE, LOSS, READING, *_TRAINING]
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
