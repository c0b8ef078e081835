"""Run the sweep: every cell under every arm and flagged share, beside its prediction."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dualhead_eval.effects.contingency import coordination
from dualhead_eval.studies.monitor.regimes.definition import Cell, Decisions, RegimeSweep
from dualhead_eval.studies.monitor.regimes.heads import Arm, Heads
from dualhead_eval.studies.monitor.regimes.outcome import Estimate, Outcome, outcome
from dualhead_eval.studies.monitor.regimes.prediction import Predicted, demonstrated_residuals
from dualhead_policy.flow.keyed_random import keyed_generator


@dataclass(frozen=True)
class Result:
    """One arm in one cell at one flagged share.

    Attributes:
        cell: The regime.
        arm: What the heads share.
        flagged_share: f.
        mismatch: x, by the law of the heads.
        crossed: Share of flagged test pairs on two sides, as measured.
        capacity: C of flagged test decisions, pooled, as measured.
        effect: Delta of them.
        obedience: As measured; None without tokens.
        found: What the alarms did.
        predicted: What the formula says.
        removed: Gap of the arm before this one less this one's: from none to apart what collapse takes away, from apart
            to shared what coordination does; None for the first arm.
    """

    cell: Cell
    arm: Arm
    flagged_share: float
    mismatch: float
    crossed: float
    capacity: float
    effect: float
    obedience: float | None
    found: Outcome
    predicted: Predicted
    removed: Estimate | None = None


@dataclass(frozen=True)
class Swept:
    """Results of the grid in its order, and of the paper's cells by name: (apart, shared)."""

    grid: list[Result]
    paper: dict[str, tuple[Result, Result]]


def run_sweep(sweep: RegimeSweep, progress: Callable[[], object] | None = None) -> Swept:
    """Run every cell; the same definition gives the same results.

    Args:
        sweep: What to run.
        progress: Called after every cell, :func:`sweep_length` times.
    """

    def advance() -> None:
        if progress is not None:
            progress()

    cells = list(sweep.axes.cells())
    alone: dict[tuple[float, float], list[Result]] = {}
    grid: list[Result] = []
    for cell in cells:
        world = (cell.prior, cell.separation)
        if world not in alone:  # no token: the token's axes change nothing
            alone[world] = _results(sweep, cell, "none", sweep.decisions, sweep.flagged_shares)
            grid += alone[world]
        apart = _results(sweep, cell, "apart", sweep.decisions, sweep.flagged_shares, alone[world])
        grid += [*apart, *_results(sweep, cell, "shared", sweep.decisions, sweep.flagged_shares, apart)]
        advance()
    paper = {}
    for name, cell in sweep.paper.cells.items():
        shares = [sweep.paper.flagged_share]
        apart = _results(sweep, cell, "apart", sweep.paper.decisions, shares)
        paper[name] = apart[0], _results(sweep, cell, "shared", sweep.paper.decisions, shares, apart)[0]
        advance()
    return Swept(grid, paper)


def sweep_length(sweep: RegimeSweep) -> int:
    """Cells in the grid and of the paper."""
    return sum(1 for _ in sweep.axes.cells()) + len(sweep.paper.cells)


def _results(
    sweep: RegimeSweep, cell: Cell, arm: Arm, decisions: Decisions, shares: Sequence[float],
    before: Sequence[Result] = (),
) -> list[Result]:  # fmt: skip
    """One arm of a cell at every flagged share; ``before`` is the arm that it is compared with."""
    heads = Heads(cell, arm, sweep.sampler)
    flagged, other = heads.flagged(decisions.flagged, "test"), heads.other(decisions.other, "test")
    table = np.zeros((2, 2), dtype=np.int64)
    np.add.at(table, (flagged.sides[:, 0], flagged.sides[:, 1]), 1)
    effects = coordination(table)
    law = demonstrated_residuals(cell.mode_angle)
    results = []
    for place, share in enumerate(shares):
        key = (sweep.inference.seed, arm, share, repr(cell))
        rng = np.random.default_rng(keyed_generator(*(repr(part) for part in key)).initial_seed())
        n = int(rng.binomial(decisions.calibration, share))
        purpose = f"calibration at {share}"
        parts = [heads.flagged(n, purpose).residual] if n else []
        parts += [heads.other(decisions.calibration - n, purpose).residual] if n < decisions.calibration else []
        found = outcome(
            np.concatenate(parts), flagged, other, alpha=sweep.alpha, draws=sweep.inference.draws, rng=rng
        )  # fmt: skip
        results.append(
            Result(
                cell=cell,
                arm=arm,
                flagged_share=share,
                mismatch=heads.mismatch,
                crossed=float(flagged.crossed.mean()),
                capacity=float(effects.capacity),
                effect=float(effects.delta),
                obedience=flagged.obedience,
                found=found,
                predicted=law.predict(share, heads.mismatch, sweep.alpha),
                removed=before[place].found.gap - found.gap if before else None,
            )
        )
    return results


def as_csv(results: Sequence[tuple[str, Result]]) -> str:
    """Named results as CSV: lengths in mm, shares between 0 and 1; the token's axes are empty without token."""
    text = io.StringIO()
    writer: csv.DictWriter[str] | None = None
    for name, result in results:
        row = _row(result) | {"name": name}
        if writer is None:
            writer = csv.DictWriter(
                text, ["name", *(column for column in row if column != "name")], lineterminator="\n"
            )
            writer.writeheader()
        writer.writerow(row)
    return text.getvalue()


def _row(result: Result) -> dict[str, str]:
    cell, found = result.cell, result.found
    tokens = result.arm != "none"
    numbers: dict[str, float | None] = {
        "prior": cell.prior,
        "token_entropy": cell.token_entropy if tokens else None,
        "replacement": cell.replacement if tokens else None,
        "separation": cell.separation,
        "flagged_share": result.flagged_share,
        "mismatch": result.mismatch,
        "crossed": result.crossed,
        "capacity": result.capacity,
        "effect": result.effect,
        "obedience": result.obedience,
        "threshold_mm": found.threshold,
        "floor_mm": found.floor,
        "flagged": found.flagged,
        "other": found.other,
    }
    for name, estimate in (("gap", found.gap), ("surcharge", found.surcharge), ("removed", result.removed)):
        numbers |= {
            name: estimate.value if estimate else None,
            f"{name}_low": estimate.interval.low if estimate else None,
            f"{name}_high": estimate.interval.high if estimate else None,
        }
    numbers |= {"predicted_threshold_mm": result.predicted.threshold, "predicted_gap": result.predicted.gap}
    written = {name: "" if value is None or value != value else f"{value:.4g}" for name, value in numbers.items()}
    return {"arm": result.arm} | written
