"""Criteria on one cell at a time: its seeds against a bound, a site, the paper or the exact reference."""

from __future__ import annotations

import numpy as np

from dualhead_envs.ring.maps import REPRESENTATION_MAPS, LinearMap
from dualhead_eval.effects.noise_law import rho_of_alignment
from dualhead_eval.effects.sites import CORNER_CAPACITY, CORNER_RHO, Occupancy
from dualhead_eval.gate import Gate
from dualhead_eval.gate.gate import DRAWS
from dualhead_eval.paper.claims.grade import FAILS, HOLDS, OPEN, UNGRADED
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.paper.numbers import paper_row
from dualhead_eval.paper.seed_spread import seed_spread
from dualhead_eval.paper.sites import paper_site
from dualhead_eval.statistics.seeds import seed_equivalence
from dualhead_eval.studies.criterion import Bound, CapacityCriterion, PrintedStatistic, SignsCriterion
from dualhead_eval.studies.grading.grade import CellGrade, points, seeds_behind, with_interval
from dualhead_eval.studies.grading.printed_cells import POSE_EFFECTS, printed_number
from dualhead_eval.studies.study_cells import StudyCell

#: Statistics of tab:collapse: the run's, the paper's, and how they are shown.
COLLAPSE = {
    "relative_capacity": ("capacity_relative", "C_rel", "C / max C"),
    "relative_entropy": ("entropy_relative", "entropy_rel", "entropy / ln K"),
}


def grade_equivalence(cell: StudyCell, margin: float) -> CellGrade:
    """TOST of rho with the seed as the unit."""
    rhos = cell.values("rho")
    if rhos.size < 2:
        return CellGrade(cell.name, UNGRADED, "fewer than two seeds that can be read")
    test = seed_equivalence(rhos, margin=margin)
    evidence = f"rho {points(rhos.mean(), test.interval)} (90 %), {seeds_behind(cell)}"
    if test.equivalent:
        return CellGrade(cell.name, HOLDS, evidence)
    outside = test.interval.low > margin or test.interval.high < -margin
    return CellGrade(cell.name, FAILS if outside else OPEN, evidence)


def grade_signs(cell: StudyCell, criterion: SignsCriterion) -> CellGrade:
    """Signs of the seeds' effects."""
    deltas = cell.values("delta")
    if deltas.size == 0:
        return CellGrade(cell.name, UNGRADED, "no seed can be read")
    up, down = int((deltas > 0).sum()), int((deltas < 0).sum())
    evidence = f"{up} seeds above zero, {down} below; rho {points(cell.mean('rho'), cell.interval())}"
    if criterion.expect == "positive":
        return CellGrade(cell.name, HOLDS if up == deltas.size else FAILS, evidence)
    if min(up, down) > 0:
        return CellGrade(cell.name, HOLDS, evidence)
    return CellGrade(cell.name, FAILS if deltas.size > 1 else UNGRADED, evidence)


def grade_site(cell: StudyCell) -> CellGrade:
    """The mean point's site against the paper's."""
    theirs = paper_site(cell.paper_row)
    evidence = (
        f"site {cell.site.site} (rho {points(cell.mean('rho'), cell.interval())}, C {cell.mean('capacity'):.3f}), "
        f"paper {theirs}"
    )
    if Occupancy.UNKNOWN.site in (theirs, cell.site.site):
        return CellGrade(cell.name, UNGRADED, evidence)
    return CellGrade(cell.name, HOLDS if cell.site.site == theirs else FAILS, evidence)


def grade_spread(cell: StudyCell) -> CellGrade:
    """The mean of rho against where one more of the paper's seeds is expected."""
    spread = seed_spread(cell.paper_row)
    mean = cell.mean("rho")
    if spread is None or mean != mean:
        return CellGrade(cell.name, UNGRADED, "the paper prints no spread, or no seed can be read")
    evidence = f"rho {points(mean, cell.interval())}, paper's next seed [{points(spread.low)}, {points(spread.high)}]"
    return CellGrade(cell.name, HOLDS if mean in spread else FAILS, evidence)


def grade_corner(cell: StudyCell) -> CellGrade:
    """The high-capacity corner's two thresholds."""
    rho, capacity = cell.mean("rho"), cell.mean("capacity_relative")
    evidence = f"rho {points(rho, cell.interval())}, C / max C {capacity:.3f}, {seeds_behind(cell)}"
    if rho != rho:
        return CellGrade(cell.name, UNGRADED, "no seed can be read")
    return CellGrade(cell.name, HOLDS if rho >= CORNER_RHO and capacity >= CORNER_CAPACITY else FAILS, evidence)


def grade_capacity(cell: StudyCell, criterion: CapacityCriterion) -> CellGrade:
    """Capacity, as it is or relative to a maximum, against bounds of the cell's dataset."""
    scale = {"absolute": 1.0, "maximum": 1 - 1 / cell.n_modes, "target": cell.target_capacity}[criterion.of]
    # A collapsed run has no rho; its capacity is the finding.
    runs = cell.valid or cell.runs
    capacities = np.array([run.first.capacity for run in runs]) / scale
    mean = float(np.mean(capacities))
    below, at_least = (_bound(bound, cell.dataset) for bound in (criterion.below, criterion.at_least))
    unit = {"absolute": "C", "maximum": "C / max C", "target": "C / target's C"}[criterion.of]
    evidence = f"{unit} {mean:.3f} ({', '.join(f'{value:.3f}' for value in capacities)})"
    if not cell.valid:
        return CellGrade(cell.name, UNGRADED, f"{evidence}, {_too_few(cell)}")
    checks = [
        *([mean < below] if below is not None else []),
        *([mean >= at_least] if at_least is not None else []),
        *([abs(mean - 1) <= criterion.within] if criterion.within is not None else []),
    ]
    if not checks or mean != mean:
        return CellGrade(cell.name, UNGRADED, evidence)
    return CellGrade(cell.name, HOLDS if all(checks) else FAILS, evidence)


def grade_minimum(cell: StudyCell, at_least: float) -> CellGrade:
    """The mean of rho against a bound."""
    rho = cell.mean("rho")
    evidence = f"rho {points(rho, cell.interval())}, {seeds_behind(cell)}"
    if rho != rho:
        return CellGrade(cell.name, UNGRADED, "no seed can be read")
    return CellGrade(cell.name, HOLDS if rho >= at_least else FAILS, evidence)


def grade_beside(cell: StudyCell, statistic: PrintedStatistic, margin: float) -> CellGrade:
    """The mean against the paper's printed cell."""
    gate = cell.runs[0].gate
    if statistic in COLLAPSE:
        # A collapsed run has no rho; its capacity and entropy are the finding.
        name, quantity, shown = COLLAPSE[statistic]
        ours = float(np.mean([getattr(run.first, name) for run in cell.valid or cell.runs]))
        theirs = printed_number(gate, "tab:collapse", quantity)
        evidence, form = f"{shown} {ours:.3f}", ".3f"
        if not cell.valid:
            evidence = f"{evidence}, {_too_few(cell)}"
    elif statistic == "rho":
        ours = cell.mean("rho")
        figure = paper_row(cell.paper_row).get("rho")
        theirs = None if figure is None else figure.value
        evidence, form = f"rho {points(ours, cell.interval())}", ""
    else:
        ours, form = cell.mean(statistic), "+.3f"
        if statistic == "delta_pooled":
            theirs = printed_number(gate, "tab:grid", "delta_pooled")
        else:
            theirs = printed_number(gate, "tab:pose", POSE_EFFECTS.get(cell.runs[0].first.heads, ""))
        evidence = f"effect {with_interval(ours, cell.interval(statistic), form)}"
    if ours != ours:
        return CellGrade(cell.name, UNGRADED, "no seed can be read")
    if theirs is None:
        return CellGrade(cell.name, UNGRADED, f"{evidence}, paper none")
    paper = format(theirs, form) if form else points(theirs)
    if not cell.valid:
        return CellGrade(cell.name, UNGRADED, f"{evidence}, paper {paper}")
    return CellGrade(cell.name, HOLDS if abs(ours - theirs) <= margin else FAILS, f"{evidence}, paper {paper}")


def grade_exact(cell: StudyCell, reference: float | None, margin: float) -> CellGrade:
    """The mean of rho against the exact reference's."""
    rho = cell.mean("rho")
    if rho != rho:
        return CellGrade(cell.name, UNGRADED, "no seed can be read")
    evidence = f"rho {points(rho, cell.interval())}, {seeds_behind(cell)}"
    if reference is None:
        return CellGrade(cell.name, UNGRADED, f"{evidence}, no reference at hand")
    grade = HOLDS if abs(rho - reference) <= margin else FAILS
    return CellGrade(cell.name, grade, f"{evidence}, optimum {points(reference)}")


def grade_law(cell: StudyCell, margin: float) -> CellGrade:
    """The mean of rho, and the seeds' signs, against the law of a linear map."""
    law, rhos = shared_noise_law(cell.runs[0].gate), cell.values("rho")
    if law is None or not rhos.size:
        return CellGrade(cell.name, UNGRADED, "no linear map, or no seed can be read")
    evidence = f"rho {points(rhos.mean(), cell.interval())}, law {points(law)}, {seeds_behind(cell)}"
    signs = abs(law) <= margin or bool((np.sign(rhos) == np.sign(law)).all())
    return CellGrade(cell.name, HOLDS if abs(rhos.mean() - law) <= margin and signs else FAILS, evidence)


def shared_noise_law(gate: Gate) -> float | None:
    """(2 / pi) asin(a): rho of two equally likely modes under shared noise and a linear map; None for other maps.

    a is the correlation of the heads' deciding projections: u' M u, where M takes the first two coordinates of the
    joint head's noise to the plane; 1 where the noise goes through the map itself. None where it depends on the
    condition, as under a reflection.
    """
    mechanism = mechanism_of(gate)
    two_heads = gate.provenance.get("method") != DRAWS
    if not two_heads or mechanism.environment != "testbed" or mechanism.n_modes != 2 or mechanism.beta != 0:
        return None
    if mechanism.largest_prior > 0.5 + 1e-9:
        return None
    chosen = REPRESENTATION_MAPS.get(mechanism.representation)
    if not isinstance(chosen, LinearMap):
        return None
    if mechanism.alignment is not None:
        return 1.0
    shared = chosen.matrix[:2]
    symmetric = (shared + shared.T) / 2
    if not np.allclose(symmetric, symmetric[0, 0] * np.eye(2)):
        return None
    return float(rho_of_alignment(symmetric[0, 0]))


def _too_few(cell: StudyCell) -> str:
    return f"not read: {cell.valid_rate:.3f} of the pairs are valid"


def _bound(bound: Bound | None, dataset: str) -> float | None:
    return bound.get(dataset) if isinstance(bound, dict) else bound
