"""The summary of a run: from conditions to two heads' effect, in the order that the protocol fixes (sec:gate).

Each condition's effect uses that condition's own marginals; a run is the mean over conditions weighted by
their both-valid pairs, its rho the ratio of the weighted means. Pooling the
tables first would book co-movement of the marginals across conditions as coordination: the pooled effect is
reported beside the run's, and their difference is the Simpson term of rmk:simpson.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dualhead_eval.effects.contingency import coordination
from dualhead_eval.effects.counts import both_valid
from dualhead_eval.effects.dependence import entropy, mutual_information
from dualhead_eval.effects.sites import Occupancy, occupancy, readable_valid_rate
from dualhead_eval.gate import Gate
from dualhead_eval.residuals.strata import summarise_strata
from dualhead_eval.statistics.bootstrap import (
    BOOTSTRAP_DRAWS,
    BOOTSTRAP_SEED,
    Equivalence,
    bootstrap_conditions,
    bootstrap_p_value,
    equivalence_test,
    p_value_floor,
)
from dualhead_eval.statistics.interval import Interval
from dualhead_eval.statistics.run_statistics import condition_sums

#: Mean both-valid pairs per condition below which the unbiased estimator is used: the plug-in one would shrink
#: the effect by more than 2%.
FEW_PAIRS = 50


@dataclass(frozen=True)
class RunSummary:
    """One run at one operating point. Fractions throughout (rho 0.91 is 91%).

    Attributes:
        label: Name of the run.
        heads: The two heads compared.
        n_modes: Number of modes K.
        tau: Threshold of the mode partition.
        nfe: Integration steps per sample.
        estimator: ``"plug-in"`` or ``"unbiased"``: what obs to rho and their intervals were computed with.
        n_conditions: Conditions evaluated.
        n_clusters: Units that the bootstrap resamples: conditions, or clusters of them (episodes).
        n_empty: Conditions without a both-valid pair (they carry no weight).
        n_pairs: Sampled pairs.
        n_both_valid: Pairs in which both heads are valid.
        valid_rate: n_both_valid / n_pairs.
        obs, bl, delta, capacity, capacity_tight: Weighted means over conditions.
        rho: delta / capacity, NaN where the capacity is zero.
        capacity_relative: capacity / (1 - 1/K).
        delta_pooled, capacity_pooled, rho_pooled: The same from the pooled table.
        simpson: delta_pooled - delta, the marginals' co-movement across conditions.
        entropy_q, entropy_p: Modal entropy of each head's pooled marginal, nats.
        mutual_information: Weighted mean of the conditions' mutual information, nats: at three modes or more
            it sees dependence that delta cannot.
        agreement_all: Pairs with both heads valid and in one mode, over all sampled pairs.
        effect_all: valid_rate * delta, the effect over all sampled pairs (the second estimand of
            sec:mode-def).
        marginal_q, marginal_p: Pooled mode frequencies among both-valid pairs.
        tv_target_q, tv_target_p: Total variation between each pooled marginal and the data's mode
            frequencies; NaN without a target.
        intervals: 95% condition-bootstrap intervals by name (obs, bl, delta, capacity, rho, valid_rate, ...).
        p_value: Two-sided bootstrap p-value of rho = 0, not adjusted for the number of runs.
        equivalence: TOST of rho against zero.
        occupancy: Site in the attainable region.
        reason: Why rho is undefined; empty where it is defined.
        partition: Name of the mode partition, empty for anyone's counts.
        name: What a report calls the run and its pair of heads; by default the label.
        p_value_is_bound: Whether no replicate lies beyond zero, so that p_value is only a bound from above.
        adjusted_p_value: p_value adjusted for the runs of a report (Benjamini and Hochberg), NaN outside one.
    """

    label: str
    heads: tuple[str, str]
    n_modes: int
    tau: float
    nfe: int
    estimator: str
    n_conditions: int
    n_clusters: int
    n_empty: int
    n_pairs: int
    n_both_valid: int
    valid_rate: float
    obs: float
    bl: float
    delta: float
    capacity: float
    capacity_tight: float
    rho: float
    capacity_relative: float
    delta_pooled: float
    capacity_pooled: float
    rho_pooled: float
    simpson: float
    entropy_q: float
    entropy_p: float
    mutual_information: float
    agreement_all: float
    effect_all: float
    marginal_q: tuple[float, ...]
    marginal_p: tuple[float, ...]
    tv_target_q: float
    tv_target_p: float
    intervals: dict[str, Interval]
    p_value: float
    equivalence: Equivalence
    occupancy: Occupancy
    reason: str
    partition: str = ""
    name: str = ""
    p_value_is_bound: bool = False
    adjusted_p_value: float = float("nan")

    @property
    def entropy_relative(self) -> float:
        """Modal entropy relative to ln K, mean of both heads; 1 if every mode is as frequent, 0 after collapse."""
        return (self.entropy_q + self.entropy_p) / 2 / math.log(self.n_modes)

    @property
    def readable(self) -> bool:
        """False if the valid-pair rate is too low for this partition to read rho."""
        return self.valid_rate >= readable_valid_rate(self.partition)

    @property
    def reading(self) -> str:
        """The summary in plain words."""
        if not self.readable:
            return f"low-validity: valid-pair rate below {readable_valid_rate(self.partition):.2f}"
        if self.occupancy is Occupancy.UNKNOWN:
            return f"not estimable: {self.reason.split(':')[0]}"
        if self.reason:
            return "collapsed: a head chose one mode in every condition"
        # Capacity before rho: where it is small, rho compares two numbers that are both nearly zero.
        if self.occupancy is Occupancy.ORIGIN:
            return f"{self.occupancy.word} ({self.occupancy.site})"
        test = self.equivalence
        if self.occupancy is Occupancy.FLOOR and not test.equivalent:
            return f"uncoordinated within ±{test.width:.1%} (I)"
        if 0.0 in self.intervals["rho"] and not test.equivalent:
            return "unclear: the sign of \N{GREEK SMALL LETTER RHO} is not established"
        return f"{self.occupancy.word} ({self.occupancy.site})"


def summarise_run(
    gate: Gate,
    *,
    heads: tuple[int, int] = (0, 1),
    tau: float | None = None,
    nfe: int | None = None,
    draws: int = BOOTSTRAP_DRAWS,
    seed: int = BOOTSTRAP_SEED,
) -> RunSummary:
    """Summary of two heads of ``gate`` at one operating point, the reference point by default.

    Conditions that share a pair id (the decisions of one recorded episode) are resampled together.

    Raises:
        KeyError: If the operating point was not evaluated.
    """
    clustered = len(np.unique(gate.pair_ids)) < len(gate.pair_ids)
    table = gate.pair_table(*heads, tau=tau, nfe=nfe)
    return summarise_table(
        table,
        label=gate.label,
        heads=(gate.heads[heads[0]], gate.heads[heads[1]]),
        tau=gate.reference_tau if tau is None else float(tau),
        nfe=gate.reference_nfe if nfe is None else int(nfe),
        target=gate.target_probabilities,
        clusters=gate.pair_ids if clustered else None,
        partition=str(gate.partition.get("name", "")),
        draws=draws,
        seed=seed,
    )


def summarise_table(
    table: ArrayLike,
    *,
    label: str = "",
    heads: tuple[str, str] = ("A", "B"),
    tau: float = float("nan"),
    nfe: int = 0,
    target: ArrayLike | None = None,
    estimator: str | None = None,
    clusters: ArrayLike | None = None,
    partition: str = "",
    draws: int = BOOTSTRAP_DRAWS,
    seed: int = BOOTSTRAP_SEED,
) -> RunSummary:
    """Summary of anyone's counts ``(n_conditions, K+1, K+1)`` (last row and column: invalid samples).

    Args:
        table: The counts.
        label: Name of the run.
        heads: Names of the two heads.
        tau: Threshold that the labels used.
        nfe: Integration steps that the samples used.
        target: Mode frequencies of the data ``(K,)``.
        estimator: ``"plug-in"`` (the protocol's) or ``"unbiased"``; by default unbiased below
            :data:`FEW_PAIRS` both-valid pairs per condition, each counting as much as the relative capacity.
        clusters: Cluster of each condition ``(n_conditions,)``; clusters are then resampled, not conditions.
        partition: Name of the mode partition.
        draws: Bootstrap replicates.
        seed: Seed of the bootstrap.

    Raises:
        ValueError: If the counts are not such a table.
    """
    counts = np.asarray(table)
    sums = condition_sums(counts, "plug-in" if estimator is None else estimator)
    if estimator is None and sums.too_few_pairs(FEW_PAIRS):
        sums = condition_sums(counts, "unbiased")
    run = {name: float(value) for name, value in sums.statistics(sums.total()).items()}
    pooled = coordination(both_valid(counts).sum(axis=0))
    units = sums if clusters is None else sums.grouped(clusters)
    resamples = bootstrap_conditions(units, draws=draws, rng=np.random.default_rng(seed))
    p_value = bootstrap_p_value(resamples, "rho")
    n_both_valid, n_pairs = int(pooled.n), int(counts.sum())
    agreeing = int(np.trace(both_valid(counts).sum(axis=0)))
    per_condition = both_valid(counts).sum(axis=(-2, -1))
    return RunSummary(
        label=label,
        heads=heads,
        n_modes=sums.n_modes,
        tau=tau,
        nfe=nfe,
        estimator=sums.estimator,
        n_conditions=len(counts),
        n_clusters=len(units.terms),
        n_empty=int((per_condition == 0).sum()),
        n_pairs=n_pairs,
        n_both_valid=n_both_valid,
        capacity_relative=run["capacity"] / (1 - 1 / sums.n_modes),
        entropy_q=float(entropy(pooled.q)),
        entropy_p=float(entropy(pooled.p)),
        mutual_information=_mean_information(both_valid(counts), per_condition),
        agreement_all=agreeing / n_pairs if n_pairs else float("nan"),
        effect_all=run["valid_rate"] * run["delta"],
        marginal_q=tuple(pooled.q.tolist()),
        marginal_p=tuple(pooled.p.tolist()),
        tv_target_q=total_variation(pooled.q, target),
        tv_target_p=total_variation(pooled.p, target),
        intervals={name: resamples.interval(name, 0.95) for name in resamples.names},
        p_value=p_value,
        p_value_is_bound=p_value <= p_value_floor(resamples, "rho"),
        equivalence=equivalence_test(resamples),
        occupancy=occupancy(run["rho"], run["capacity"], sums.n_modes),
        reason=_reason(run, n_both_valid),
        partition=partition,
        name=label,
        **run,
    )


def total_variation(generated: ArrayLike, target: ArrayLike | None) -> float:
    """Half of sum |generated_k - target_k|: behavioural-prior fidelity, which is not TV(q, p).

    NaN without a target. Unlike capacity it says whether the modes have the data's frequencies.
    """
    if target is None:
        return float("nan")
    return float(0.5 * np.abs(np.asarray(generated) - np.asarray(target)).sum())


def residual_mm(gate: Gate, tau: float | None = None, nfe: int | None = None) -> float | None:
    """Mean cross-head position residual in mm at one operating point, None if the gate holds none."""
    if "position" not in gate.strata:
        return None
    return summarise_strata(gate.strata["position"].at(gate.index(tau, nfe))).mean


def _mean_information(tables: NDArray, weight: NDArray) -> float:
    used = weight > 0
    if not used.any():
        return float("nan")
    return float(np.average(mutual_information(tables[used]), weights=weight[used]))


def _reason(run: dict[str, float], n_both_valid: int) -> str:
    if n_both_valid == 0:
        return "no pair in which both heads are valid: only the valid-pair rate is defined"
    if np.isnan(run["delta"]):
        return "no condition has two both-valid pairs: only the pooled effect exists, which mixes conditions"
    if np.isnan(run["rho"]):
        return "in every condition a head chose a single mode: capacity is zero and rho is undefined"
    return ""
