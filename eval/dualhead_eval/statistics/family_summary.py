"""Seeds of one mechanism found among gates, and their summary with the seed as the unit."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from dualhead_eval.gate.gate import Gate
from dualhead_eval.report.content import Row
from dualhead_eval.statistics.bootstrap import Equivalence, Interval
from dualhead_eval.statistics.run_summary import FamilySummary, summarise_family
from dualhead_eval.statistics.seeds import seed_equivalence, seed_t_interval

#: Provenance that may differ between the seeds of one family.
_PER_SEED = {"label", "seed", "training", "seeds", "path", "run", "merged_from"}


@dataclass(frozen=True)
class FamilyRow:
    """A family's mean over seeds.

    Attributes:
        summary: Means and between-seed standard deviations.
        rho_interval: 95% t interval of the mean rho over seeds, None with a single defined seed.
        equivalence: Seed-level TOST of rho at 2%, None with a single defined seed.
    """

    summary: FamilySummary
    rho_interval: Interval | None
    equivalence: Equivalence | None


def family_key(gate: Gate) -> str:
    """What two gates must share to be seeds of one mechanism: everything but the seed and what follows from it."""
    provenance = {key: value for key, value in gate.provenance.items() if key not in _PER_SEED}
    if isinstance(provenance.get("config"), dict):
        provenance["config"] = {k: v for k, v in provenance["config"].items() if k not in _PER_SEED}
    return json.dumps([gate.heads, gate.n_modes, provenance], sort_keys=True, default=str)


def family_rows(gates: Sequence[Gate], rows: Iterable[Row]) -> list[FamilyRow]:
    """Families with two or more readable seeds, first pair of heads, in the order of their first gate."""
    first = [row for row in rows if row.first_pair]
    members: dict[str, list[Row]] = {}
    for gate, row in zip(gates, first, strict=True):
        if row.readable:
            members.setdefault(family_key(gate), []).append(row)
    families = []
    for seeds in members.values():
        if len(seeds) < 2:
            continue
        summary = summarise_family(_common_label([row.summary.label for row in seeds]), [r.summary for r in seeds])
        defined = [run.rho for run in summary.runs if np.isfinite(run.rho)]
        enough = len(defined) > 1
        families.append(
            FamilyRow(
                summary,
                seed_t_interval(defined) if enough else None,
                seed_equivalence(defined) if enough else None,
            )
        )
    return families


def _common_label(labels: Sequence[str]) -> str:
    """The seeds' labels without what tells them apart, for example ``"token"`` of ``"token seed 0"``."""
    same = takewhile(lambda letters: len(set(letters)) == 1, zip(*labels, strict=False))
    common = "".join(letters[0] for letters in same).rstrip(" -_/,.([0123456789")
    return common.removesuffix("seed").rstrip(" -_/,.([") or labels[0]
