"""The claims of tab:claims, graded on whatever runs are given.

A grade says what these runs show, by the criterion named beside it; a claim whose runs are missing is not
graded. Nothing here pools seeds before the effect is formed.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dualhead_eval.effects.contingency import coordination
from dualhead_eval.effects.counts import both_valid, pair_counts
from dualhead_eval.effects.sites import Occupancy
from dualhead_eval.paper.mechanism import Mechanism, mechanism_of
from dualhead_eval.statistics.run import Run
from dualhead_eval.statistics.run_summary import RunSummary
from dualhead_eval.statistics.seeds import interaction_test

#: Map dependence counts as shown when the signs differ and the spread exceeds this (the paper: 90 points).
MAP_SPREAD = 0.10


@dataclass(frozen=True)
class Grade:
    """One claim and what the runs say about it.

    Attributes:
        claim: The claim, as in tab:claims.
        grade: ``holds``, ``does not hold``, ``inconclusive`` or ``not graded``.
        evidence: The numbers behind the grade.
        criterion: What would make it hold.
    """

    claim: str
    grade: str
    evidence: str
    criterion: str


@dataclass(frozen=True)
class _Run:
    summary: RunSummary
    mechanism: Mechanism


def grade_claims(given: Sequence[Run]) -> list[Grade]:
    """Grades of every claim of tab:claims, in its order.

    Ring runs whose valid-pair rate is too low are left out of every claim but the first: they are under-trained. On the
    robots a low rate is a finding of its own, the cost of consistency, and stays.
    """
    kept = [run for run in given if run.first.readable or run.first.partition != "ring"]
    runs = [_Run(run.first, mechanism_of(run.gate)) for run in kept]
    # References have no seed and stand in only where nothing was trained.
    runs = [run for run in runs if not run.mechanism.reference] or runs
    external = "the external benchmark's traces are not among the runs"
    return [
        _bound(given),
        _auxiliary_latent(runs),
        _shared_noise(runs),
        _consistency(runs),
        _tokens(runs),
        *(
            Grade(claim, "not graded", external, "needs the LIBERO-Plus monitor experiment")
            for claim in (
                "Benign multimodality raises residual false alarms",
                "Coordination shrinks the multimodal false-alarm surcharge",
                "Coordination improves failure detection",
                "Low capacity and token entropy explain the external null",
            )
        ),
    ]


def _bound(runs: Sequence[Run]) -> Grade:
    tables = violations = 0
    for run in runs:
        heads, counts = len(run.gate.heads), run.gate.counts
        for first, second in combinations(range(heads), 2):
            effect = coordination(both_valid(pair_counts(counts, heads, first, second)))
            defined = effect.n > 0
            tables += int(defined.sum())
            outside = (np.abs(effect.delta) > effect.capacity) | (effect.delta > effect.capacity_tight)
            violations += int((outside & defined).sum())
    claim, criterion = (
        "|Delta| <= C and Delta <= C_tight in every condition",
        "no table outside (an identity)",
    )
    if not tables:
        return Grade(claim, "not graded", "no condition has a both-valid pair", criterion)
    grade = "holds" if violations == 0 else "does not hold"
    return Grade(claim, grade, f"{violations} of {tables} tables outside the bounds", criterion)


def _auxiliary_latent(runs: Sequence[_Run]) -> Grade:
    claim = "An auxiliary latent outside the construction leaves the heads uncoordinated"
    criterion = "every run passes TOST on rho at 2%"
    chosen = [run for run in runs if run.mechanism.latent == "prior"]
    tests = [run.summary.equivalence for run in chosen]
    if not chosen:
        return Grade(claim, "not graded", "no run with a prior latent", criterion)
    if any(test.equivalent is None for test in tests):
        return Grade(claim, "inconclusive", "rho is undefined in a run", criterion)
    passed = sum(bool(test.equivalent) for test in tests)
    widest = max(test.width for test in tests)
    outside = [t for t in tests if t.interval.low > t.margin or t.interval.high < -t.margin]
    grade = "holds" if passed == len(tests) else "does not hold" if outside else "inconclusive"
    return Grade(claim, grade, f"{passed} of {len(tests)} runs within 2%, widest band {widest:.2%}", criterion)


def _shared_noise(runs: Sequence[_Run]) -> Grade:
    claim = "The effect of shared source noise depends on the representation map, up to its sign"
    criterion = f"effects of both signs and a spread above {MAP_SPREAD:.0%} over two or more maps, at p < 5% over seeds"
    arms: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for run in runs:
        m = run.mechanism
        if m.environment == "testbed" and m.n_modes == 2 and m.family.startswith(("A ", "B ")):
            arms[m.representation][m.family[0]].append(run.summary.rho)
    both = {name: arm for name, arm in arms.items() if arm["A"] and arm["B"]}
    # Without an uncoupled run on a map the shared-noise rho itself is the effect.
    effects = {
        name: float(np.mean(arm["B"]) - (np.mean(arm["A"]) if arm["A"] else 0.0))
        for name, arm in arms.items()
        if arm["B"]
    }
    if len(effects) < 2:
        return Grade(claim, "not graded", "shared noise on fewer than two maps", criterion)
    spread = max(effects.values()) - min(effects.values())
    evidence = ", ".join(f"{name} {value:+.1%}" for name, value in sorted(effects.items()))
    evidence += f"; spread {100 * spread:.1f} points"
    seeds = min((min(len(arm["A"]), len(arm["B"])) for arm in both.values()), default=0)
    if len(both) == len(effects) and seeds >= 2:
        cells = [[b - a for a, b in zip(arm["A"][:seeds], arm["B"][:seeds], strict=True)] for arm in both.values()]
        test = interaction_test(cells, rng=np.random.default_rng(0))
        evidence += f"; permutation p = {test.p_value:.2g} over {seeds} seeds"
        established = test.p_value < 0.05
    else:
        established = all(run.mechanism.reference for run in runs)
        evidence += "; the population's own effect" if established else "; one seed a map, no test"
    if not min(effects.values()) < 0 < max(effects.values()) or spread <= MAP_SPREAD:
        return Grade(claim, "does not hold", evidence, criterion)
    return Grade(claim, "holds" if established else "inconclusive", evidence, criterion)


def _consistency(runs: Sequence[_Run]) -> Grade:
    claim = "Endpoint consistency coordinates without a partition, at a cost in valid pairs"
    criterion = "95% interval of rho above zero, valid-pair rate below the independent run's (robots)"
    robots = [run for run in runs if run.mechanism.environment in ("v2", "v3")]
    chosen = [r for r in robots if r.mechanism.consistency >= 3 and r.mechanism.beta == 0 and not r.mechanism.token]
    if not chosen:
        return Grade(claim, "not graded", "no robot run with consistency weight 3 and shared noise", criterion)
    above = [run for run in chosen if run.summary.intervals["rho"].low > 0]
    evidence = ", ".join(f"{run.summary.label}: rho {run.summary.rho:+.1%}" for run in chosen)
    grade = "holds" if len(above) == len(chosen) else "inconclusive" if above else "does not hold"
    costs = []
    for environment in sorted({run.mechanism.environment for run in chosen}):
        base = [r.summary.valid_rate for r in robots if r.mechanism.paper_row == f"{environment}/A independent"]
        mine = [r.summary.valid_rate for r in chosen if r.mechanism.environment == environment]
        if base:
            costs.append(float(np.mean(base) - np.mean(mine)))
            evidence += f"; {environment} valid-pair rate {np.mean(base):.3f} to {np.mean(mine):.3f}"
    if not costs:
        evidence += "; cost not graded without an independent run"
    elif min(costs) <= 0 and grade == "holds":
        grade = "inconclusive"
    return Grade(claim, grade, evidence, criterion)


def _tokens(runs: Sequence[_Run]) -> Grade:
    claim = "Partition tokens reach the high-capacity corner on the robots"
    criterion = "every token run at rho >= 85% and C >= 0.80 max C"
    chosen = [run for run in runs if run.mechanism.token and run.mechanism.environment in ("v2", "v3")]
    if not chosen:
        return Grade(claim, "not graded", "no robot run with a token", criterion)

    reached = [run for run in chosen if run.summary.occupancy is Occupancy.CORNER]
    evidence = f"{len(reached)} of {len(chosen)} runs in the corner: "
    evidence += ", ".join(f"{run.summary.label} {run.summary.rho:+.1%}" for run in chosen)
    grade = "holds" if len(reached) == len(chosen) else "inconclusive" if reached else "does not hold"
    return Grade(claim, grade, evidence, criterion)
