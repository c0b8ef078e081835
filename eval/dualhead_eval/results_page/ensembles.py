"""Ensembles with committed gate files: do their members choose together, and what do their scores measure?"""

from __future__ import annotations

from pathlib import Path

from dualhead_eval.ensembles.summary import is_ensemble
from dualhead_eval.gate import Gate, read_gate
from dualhead_eval.report.ensemble_tables import contamination_table, ensemble_choices_table
from dualhead_eval.report.table import Cell, Table
from dualhead_eval.results_page.template import markdown_table

RESULTS = Path("results") / "ensembles"
NOTHING = "No gate file of an ensemble is committed yet: `dualhead ensemble` makes them."
#: Gate files of an ensemble in the order in which its lines are printed.
SCORES = ("private", "shared", "vfd_unweighted", "vfd")


def ensemble_sections(arguments: list[str]) -> str:
    """``ensembles``: both tables over every ensemble below ``results/ensembles``.

    Raises:
        ValueError: If a gate file is damaged or no ensemble's.
    """
    if arguments:
        raise ValueError(f"the ensembles take no arguments, {' '.join(arguments)!r} was given")
    gates = _gates()
    if not gates:
        return NOTHING
    return "\n\n".join(_section(table) for table in (ensemble_choices_table(gates), contamination_table(gates)))


def _gates() -> list[Gate]:
    gates = []
    for folder in sorted(path for path in RESULTS.glob("*") if path.is_dir()):
        for score in SCORES:
            for file in sorted(folder.glob(f"{score}.gate.json*")):
                gate = read_gate(file)
                if not is_ensemble(gate):
                    raise ValueError(f"{file} is no ensemble's gate file, expected one of `dualhead ensemble`")
                gates.append(gate)
    return gates


def _section(table: Table) -> str:
    rows = [[cell.text if isinstance(cell, Cell) else cell for cell in row] for row in table.rows]
    return f"{markdown_table([column.name for column in table.columns], rows)}\n\n{' '.join(table.notes)}"
