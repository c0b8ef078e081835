"""Which cells a criterion is about, and the test that grades them.

A criterion without a budget of its own is about the end of each row's longest runs, on the study's first bank;
equivalence and order are about every budget and checkpoint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from dualhead_eval.paper.claims.grade import HOLDS, OPEN
from dualhead_eval.studies.closed_loop_store import LoopResult
from dualhead_eval.studies.criterion import (
    AccountsCriterion,
    BanksCriterion,
    BesideCriterion,
    CapacityCriterion,
    ClosedLoopCriterion,
    CornerCriterion,
    CriterionBase,
    DifferenceCriterion,
    EquivalenceCriterion,
    ExactCriterion,
    InteractionCriterion,
    LawCriterion,
    MinimumCriterion,
    MonotoneCriterion,
    OrderCriterion,
    RankingCriterion,
    RepairsCriterion,
    SignsCriterion,
    SiteCriterion,
    SpreadCriterion,
    TrendCriterion,
)
from dualhead_eval.studies.grading import comparisons, single_cells
from dualhead_eval.studies.grading.closed_loops import grade_closed_loop
from dualhead_eval.studies.grading.grade import CellGrade, StudyGrade, together
from dualhead_eval.studies.grading.rankings import grade_ranking
from dualhead_eval.studies.study_cells import StudyCell
from dualhead_eval.studies.study_file import StudyFile

#: rho of the exact reference of a cell, None where there is none at hand.
Reference = Callable[[StudyCell], float | None]


def grade_study(
    study: StudyFile, cells: Sequence[StudyCell], reference: Reference, loops: Sequence[LoopResult] = ()
) -> list[StudyGrade]:
    """Every criterion of a study, in the file's order.

    Args:
        study: The study.
        cells: Its cells that are there.
        reference: rho of a cell's exact reference.
        loops: Its closed loops that are there.
    """
    return [_Grader(study, cells, criterion, reference, loops).grade() for criterion in study.criteria]


class _Grader:
    """One criterion and the cells that it is about."""

    def __init__(
        self,
        study: StudyFile,
        cells: Sequence[StudyCell],
        criterion: CriterionBase,
        reference: Reference,
        loops: Sequence[LoopResult],
    ) -> None:
        self.study, self.cells, self.criterion, self.reference, self.loops = study, cells, criterion, reference, loops
        self.first_bank = next(iter(study.banks))
        self.datasets = criterion.datasets or list(study.datasets)
        self.used: dict[str, StudyCell] = {}

    def grade(self) -> StudyGrade:
        graded = list(self._graded())
        there = {cell.configuration for cell in self.cells}
        if isinstance(self.criterion, ClosedLoopCriterion):
            there = {loop.loop.run.configuration for loop in self.loops}
        absent = [row for row in self.criterion.all_rows if row not in there]
        shortage = [f"{row}: no run" for row in absent]
        shortage += [f"{name}: {cell.shortage}" for name, cell in self.used.items() if cell.shortage]
        grade = together(graded)
        if grade == HOLDS and absent:
            grade = OPEN  # it holds where every row that it names was run
        own = self.criterion
        return StudyGrade(own.name, own.claim, own.criterion, grade, tuple(graded), tuple(shortage))

    def _graded(self) -> Iterable[CellGrade]:
        criterion = self.criterion
        match criterion:
            case EquivalenceCriterion():
                for cell in self._rows(criterion.rows, every=True):
                    yield single_cells.grade_equivalence(cell, criterion.margin)
            case SignsCriterion():
                for cell in self._rows(criterion.rows):
                    yield single_cells.grade_signs(cell, criterion)
            case SiteCriterion():
                yield from map(single_cells.grade_site, self._rows(criterion.rows))
            case SpreadCriterion():
                yield from map(single_cells.grade_spread, self._rows(criterion.rows))
            case CornerCriterion():
                yield from map(single_cells.grade_corner, self._rows(criterion.rows))
            case CapacityCriterion():
                for cell in self._rows(criterion.rows):
                    yield single_cells.grade_capacity(cell, criterion)
            case MinimumCriterion():
                for cell in self._rows(criterion.rows):
                    yield single_cells.grade_minimum(cell, criterion.at_least)
            case BesideCriterion():
                for cell in self._rows(criterion.rows):
                    yield single_cells.grade_beside(cell, criterion.statistic, criterion.margin)
            case LawCriterion():
                for cell in self._rows(criterion.rows):
                    yield single_cells.grade_law(cell, criterion.margin)
            case ClosedLoopCriterion():
                for result in self.loops:
                    if result.loop.run.configuration in criterion.rows and result.loop.run.dataset in self.datasets:
                        yield grade_closed_loop(result, criterion)
            case ExactCriterion():
                for cell in self._rows(criterion.rows):
                    if criterion.at in (None, cell.step):
                        yield single_cells.grade_exact(cell, self.reference(cell), criterion.margin)
            case _:
                yield from self._compared()

    def _compared(self) -> Iterable[CellGrade]:
        criterion = self.criterion
        match criterion:
            case DifferenceCriterion():
                for cell, baseline in self._against(criterion.baseline):
                    yield comparisons.grade_difference(cell, baseline, criterion)
            case RepairsCriterion():
                for cell, baseline in self._against(criterion.baseline):
                    yield comparisons.grade_repairs(cell, baseline)
            case AccountsCriterion():
                names = [criterion.whole, criterion.baseline[0], *criterion.rows]
                for dataset in self.datasets:
                    compared = self._of_one_budget(dataset, names, self.first_bank)
                    found = {cell.configuration: cell for cell in compared}
                    if names[0] in found and names[1] in found:
                        rows = [found[row] for row in criterion.rows if row in found]
                        yield comparisons.grade_accounts(rows, found[names[0]], found[names[1]], criterion.share)
            case MonotoneCriterion():
                for dataset in self.datasets:
                    rungs = self._of_one_budget(dataset, criterion.rows, self.first_bank)
                    if len(rungs) > 1:
                        yield comparisons.grade_monotone(rungs)
            case InteractionCriterion():
                for bank in criterion.banks or [self.first_bank]:
                    arms = [
                        pair
                        for dataset in self.datasets
                        if (pair := self._pair(dataset, criterion.rows[0], criterion.baseline[0], bank))
                    ]
                    if arms:
                        yield comparisons.grade_interaction(arms, bank)
            case BanksCriterion():
                for dataset in self.datasets:
                    pairs = [
                        self._pair(dataset, criterion.rows[0], criterion.baseline[0], bank) for bank in criterion.banks
                    ]
                    if all(pairs):
                        yield comparisons.grade_banks([pair for pair in pairs if pair], criterion)
            case TrendCriterion():
                for dataset in self.datasets:
                    for row in criterion.rows:
                        start = self._row(dataset, row, step=criterion.start)
                        end = self._row(dataset, row, step=criterion.end)
                        if start is not None and end is not None:
                            yield comparisons.grade_trend(start, end, criterion)
            case RankingCriterion():
                for dataset in self.datasets:
                    if ranked := self._of_one_budget(dataset, criterion.rows, criterion.banks[0]):
                        yield grade_ranking(ranked, criterion)
            case OrderCriterion():
                cells = list(self._rows(criterion.rows, every=True))
                for dataset in self.datasets:
                    if own := [cell for cell in cells if cell.dataset == dataset]:
                        yield comparisons.grade_order(own, criterion.at_most)

    def _against(self, baselines: Sequence[str]) -> Iterable[tuple[StudyCell, StudyCell]]:
        """Every row with its baseline on every dataset; a single baseline serves all rows."""
        rows = self.criterion.rows
        partners: Mapping[str, str] = dict(zip(rows, list(baselines) * len(rows), strict=False))
        for dataset in self.datasets:
            for row in rows:
                pair = self._pair(dataset, row, partners[row], self.first_bank)
                if pair is not None:
                    yield pair

    def _pair(self, dataset: str, row: str, baseline: str, bank: str) -> tuple[StudyCell, StudyCell] | None:
        both = self._of_one_budget(dataset, [row, baseline], bank)
        return (both[0], both[1]) if len(both) == 2 else None

    def _rows(self, rows: Sequence[str], *, every: bool = False) -> Iterable[StudyCell]:
        """Cells of some rows on the criterion's datasets: the end of the longest runs, or every one."""
        for dataset in self.datasets:
            for row in rows:
                if every:
                    yield from (self._use(cell) for cell in self._of(dataset, row, self.first_bank))
                elif (found := self._row(dataset, row)) is not None:
                    yield found

    def _row(self, dataset: str, row: str, *, bank: str | None = None, step: int | None = None) -> StudyCell | None:
        """The end of a row's longest runs, or its cell at a step."""
        found = self._of(dataset, row, bank or self.first_bank)
        found = [cell for cell in found if (cell.final if step is None else cell.step == step)]
        return self._use(max(found, key=lambda cell: cell.budget)) if found else None

    def _of_one_budget(self, dataset: str, rows: Sequence[str], bank: str) -> list[StudyCell]:
        """The ends of the rows' runs, in their order, at the longest budget that most of the rows have.

        Rows of different budgets are not compared: what they differ in could be the budget.
        """
        ends = [{cell.budget: cell for cell in self._of(dataset, row, bank) if cell.final} for row in rows]
        budgets = {budget for row in ends for budget in row}
        if not budgets:
            return []
        chosen = max(budgets, key=lambda budget: (sum(budget in row for row in ends), budget))
        return [self._use(row[chosen]) for row in ends if chosen in row]

    def _of(self, dataset: str, row: str, bank: str) -> list[StudyCell]:
        own = [cell for cell in self.cells if (cell.dataset, cell.configuration, cell.bank) == (dataset, row, bank)]
        heads = self.criterion.heads
        return own if heads is None else [cell.of_heads(heads) for cell in own]

    def _use(self, cell: StudyCell) -> StudyCell:
        self.used[cell.name if cell.bank == self.first_bank else f"{cell.name} ({cell.bank})"] = cell
        return cell
