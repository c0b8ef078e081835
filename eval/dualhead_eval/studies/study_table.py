"""A study's tidy table: one row per run, checkpoint and bank, as CSV and as what it is read from."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any

from dualhead_eval.paper.numbers import paper_row
from dualhead_eval.studies.gate_store import fingerprint, training_data
from dualhead_eval.studies.study_cells import StudyCell
from dualhead_eval.studies.study_references import StudyReferences

COLUMNS = (
    "dataset", "configuration", "budget", "seed", "step", "bank", "rho", "rho_low", "rho_high", "valid_rate",
    "capacity", "capacity_relative", "delta", "obs", "bl", "residual_mm", "tv_target", "entropy_relative", "readable",
    "site", "final_loss", "plateaued", "judged_loss", "paper_row", "paper_rho", "exact_rho", "n_conditions",
    "pairs_per_condition", "tau", "nfe",
    "dataset_fingerprint", "training_fingerprint", "precision", "device",
)  # fmt: skip


def study_rows(cells: Iterable[StudyCell], references: StudyReferences) -> list[dict[str, Any]]:
    """One row per run, checkpoint and bank. Intervals are over conditions, 95 %."""
    rows = []
    for cell in cells:
        printed = paper_row(cell.paper_row).get("rho")
        exact = references.rho(cell)
        for result, run in zip(cell.results, cell.runs, strict=True):
            first, gate = run.first, result.gate
            training, made = gate.provenance.get("training") or {}, gate.provenance.get("run") or {}
            interval = first.intervals["rho"]
            rows.append(
                {
                    "dataset": cell.dataset,
                    "configuration": cell.configuration,
                    "budget": cell.budget,
                    "seed": result.seed,
                    "step": cell.step,
                    "bank": cell.bank,
                    "rho": first.rho,
                    "rho_low": interval.low,
                    "rho_high": interval.high,
                    "valid_rate": first.valid_rate,
                    "capacity": first.capacity,
                    "capacity_relative": first.capacity_relative,
                    "delta": first.delta,
                    "obs": first.obs,
                    "bl": first.bl,
                    "residual_mm": run.residual_mm,
                    "tv_target": (first.tv_target_q + first.tv_target_p) / 2,
                    "entropy_relative": first.entropy_relative,
                    "readable": first.readable,
                    "site": first.occupancy.site,
                    "final_loss": training.get("final_loss"),
                    "plateaued": training.get("plateaued"),
                    "judged_loss": training.get("judged_loss"),
                    "paper_row": cell.paper_row,
                    "paper_rho": None if printed is None else printed.value,
                    "exact_rho": exact,
                    "n_conditions": gate.n_conditions,
                    "pairs_per_condition": gate.provenance.get("pairs_per_condition"),
                    "tau": first.tau,
                    "nfe": first.nfe,
                    "dataset_fingerprint": fingerprint(gate),
                    "training_fingerprint": training_data(gate),
                    "precision": made.get("precision"),
                    "device": made.get("device"),
                }
            )
    return rows


def csv_text(rows: Sequence[dict[str, Any]]) -> str:
    """Rows as CSV: six significant digits, an empty cell for what is undefined."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({name: _cell(row[name]) for name in COLUMNS})
    return text.getvalue()


def _cell(value: Any) -> str:
    if value is None or value != value:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)
