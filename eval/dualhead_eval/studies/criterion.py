"""Criteria of a study: one schema per test, so that a criterion says before its runs what will decide it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from dualhead_envs.validated_json import Schema
from dualhead_policy.training.sweep.sweep_file import Name

Rows = Annotated[list[Name], Field(min_length=1)]
Share = Annotated[float, Field(ge=0, le=1)]
Bound = float | dict[Name, float]
PrintedStatistic = Literal["rho", "relative_capacity", "relative_entropy", "delta_pooled", "delta"]


class CriterionBase(Schema):
    """What every criterion has.

    Attributes:
        name: Its name.
        claim: The claim that it judges.
        criterion: When the claim holds, in words.
        rows: Names of the configurations that it is about.
        datasets: Datasets that it is about; None: all on which the rows were trained.
        heads: The pair of heads that it is about; None: the first two, joint and position.
    """

    name: Name
    claim: str
    criterion: str
    rows: Rows
    datasets: list[Name] | None = None
    heads: Annotated[list[Name], Field(min_length=2, max_length=2)] | None = None

    @property
    def all_rows(self) -> list[str]:
        """Every configuration that it names."""
        others = [*(getattr(self, "baseline", None) or ()), *(getattr(self, "beside", None) or ())]
        whole = getattr(self, "whole", None)
        return [*self.rows, *others, *([whole] if whole else [])]

    @property
    def all_datasets(self) -> list[str]:
        """Every dataset that it names."""
        bounds = [getattr(self, name, None) for name in ("below", "at_least")]
        return [*(self.datasets or ()), *(key for bound in bounds if isinstance(bound, dict) for key in bound)]

    @property
    def all_banks(self) -> list[str]:
        """Every bank that it names."""
        return list(getattr(self, "banks", None) or ())


class EquivalenceCriterion(CriterionBase):
    """Seed-level TOST of rho at ``margin``, cell by cell."""

    test: Literal["equivalence"]
    margin: Share


class SignsCriterion(CriterionBase):
    """Signs of the seeds' effects: both must occur, or all must be positive."""

    test: Literal["signs"]
    expect: Literal["both", "positive"] = "both"
    beside: list[Name] | None = None


class SiteCriterion(CriterionBase):
    """The site of the seeds' mean, against the one that the paper assigns."""

    test: Literal["site"]


class SpreadCriterion(CriterionBase):
    """The seeds' mean of rho, against where one more of the paper's seeds is expected."""

    test: Literal["spread"]


class DifferenceCriterion(CriterionBase):
    """Rows less their baselines, Welch over seeds; one baseline for all rows, or one for each.

    Attributes:
        statistic: What must rise (or, with ``within``, stay).
        cost: Whether the valid-pair rate must fall, too.
        within: Largest change that counts as none.
    """

    test: Literal["difference"]
    baseline: Rows
    statistic: Literal["rho", "valid_rate"] = "rho"
    cost: bool = True
    within: Share | None = None


class AccountsCriterion(CriterionBase):
    """Whether one row alone makes up a share of the difference between ``whole`` and the baseline."""

    test: Literal["accounts"]
    baseline: Rows
    whole: Name
    share: Share


class MonotoneCriterion(CriterionBase):
    """The seeds' mean of rho increases from row to row."""

    test: Literal["monotone"]


class CornerCriterion(CriterionBase):
    """The seeds' means of rho and C lie in the high-capacity corner."""

    test: Literal["corner"]


class CapacityCriterion(CriterionBase):
    """The seeds' mean of C, as it is, relative to 1 - 1/K, or to the capacity of the target's own priors."""

    test: Literal["capacity"]
    of: Literal["absolute", "maximum", "target"] = "absolute"
    within: Share | None = None
    below: Bound | None = None
    at_least: Bound | None = None


class InteractionCriterion(CriterionBase):
    """Permutation test: does the difference of row and baseline depend on the dataset (the map)?"""

    test: Literal["interaction"]
    baseline: Rows
    banks: list[Name] | None = None


class BanksCriterion(CriterionBase):
    """The sign of row less baseline, bank by bank, and whether the banks agree."""

    test: Literal["sign_on_banks"]
    baseline: Rows
    banks: Annotated[list[Name], Field(min_length=2)]
    expect: Literal["negative", "positive"]
    margin: Share


class ExactCriterion(CriterionBase):
    """The seeds' mean of rho, against the exact reference or the optimum of the loss."""

    test: Literal["exact"]
    margin: Share
    at: int | None = None


class LawCriterion(CriterionBase):
    """The seeds' mean of rho, and every seed's sign, against the law of the linear maps, (2 / pi) asin(alignment)."""

    test: Literal["law"]
    margin: Share


class BesideCriterion(CriterionBase):
    """The seeds' mean, against the paper's printed cell.

    Attributes:
        margin: Largest distance at which the two count as alike.
        statistic: rho of the main tables; C and entropy relative to their maximum (tab:collapse); the pooled effect
            (tab:grid); the effect of a pair among three heads (tab:pose).
    """

    test: Literal["beside"]
    margin: Share
    statistic: PrintedStatistic = "rho"


class TrendCriterion(CriterionBase):
    """rho at one number of steps less rho at an earlier one, paired by seed."""

    test: Literal["trend"]
    margin: Share
    start: int = Field(alias="from")
    end: int = Field(alias="to")


class OrderCriterion(CriterionBase):
    """Rank correlation of the cells' mean rho with their mean valid-pair rate."""

    test: Literal["order"]
    at_most: Annotated[float, Field(ge=-1, le=1)]


class RankingCriterion(CriterionBase):
    """The rows' order by their mean effect, at every threshold and number of Euler steps of a bank.

    Attributes:
        banks: The bank; its gates hold several operating points.
        between: Smallest and largest threshold at which it is asked.
        tie: Rows whose effects differ by no more than this do not count as ordered.
    """

    test: Literal["ranking"]
    banks: Annotated[list[Name], Field(min_length=1, max_length=1)]
    between: Annotated[list[float], Field(min_length=2, max_length=2)]
    tie: Share


class MinimumCriterion(CriterionBase):
    """The seeds' mean of rho, against a bound."""

    test: Literal["minimum"]
    at_least: Share


class RepairsCriterion(CriterionBase):
    """A row distorts the modes' frequencies less than its baseline, and coordinates more."""

    test: Literal["repairs"]
    baseline: Rows


class ClosedLoopCriterion(CriterionBase):
    """Success in closed loop, loop by loop: Wilson's lower end over all episodes, and over those of every way.

    Attributes:
        at_least: Bound over all episodes.
        each_way_at_least: Bound over the episodes of each mode; a mode that no episode took is not driven.
    """

    test: Literal["closed_loop"]
    at_least: Share
    each_way_at_least: Share


Criterion = Annotated[
    EquivalenceCriterion
    | SignsCriterion
    | SiteCriterion
    | SpreadCriterion
    | DifferenceCriterion
    | AccountsCriterion
    | MonotoneCriterion
    | CornerCriterion
    | CapacityCriterion
    | InteractionCriterion
    | BanksCriterion
    | ExactCriterion
    | LawCriterion
    | BesideCriterion
    | TrendCriterion
    | OrderCriterion
    | RankingCriterion
    | MinimumCriterion
    | RepairsCriterion
    | ClosedLoopCriterion,
    Field(discriminator="test"),
]
