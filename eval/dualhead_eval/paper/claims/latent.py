"""The claim that a latent outside the flow's construction does nothing: equivalence to zero, run by run and by seed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from dualhead_eval.paper.claims.grade import FAILS, HOLDS, OPEN, UNGRADED, Grade, Measured, grade_of
from dualhead_eval.statistics.bootstrap import Equivalence
from dualhead_eval.statistics.family_summary import family_key
from dualhead_eval.statistics.seeds import seed_equivalence

CLAIM = "An auxiliary latent outside the construction leaves the heads uncoordinated"
CRITERION = "every run, and every mean over two or more seeds, passes TOST on rho at 2%"


def grade_latent(measured: Sequence[Measured]) -> Grade:
    """TOST on every trained run with a prior latent and nothing else that the heads share."""
    chosen = [
        m
        for m in measured
        if m.mechanism.latent == "prior"
        and m.mechanism.standard
        and not m.mechanism.reference
        # With shared noise, consistency or a token the heads share more than the latent.
        and m.mechanism.beta == 1
        and m.mechanism.consistency == 0
        and m.mechanism.token is None
    ]
    if not chosen:
        return Grade(CLAIM, UNGRADED, "no run with a prior latent and nothing else shared", CRITERION)
    tests = [m.run.first.equivalence for m in chosen]
    by_setting: dict[str, list[float]] = defaultdict(list)
    for m in chosen:
        by_setting[family_key(m.run.gate)].append(m.run.first.rho)
    if any(test.equivalent is None for test in tests):
        return grade_of(CLAIM, OPEN, "rho is undefined in a run", CRITERION, chosen)
    seed_tests = [seed_equivalence(rhos) for rhos in by_setting.values() if len(rhos) > 1]
    everything = [*tests, *seed_tests]
    passed = sum(bool(test.equivalent) for test in tests)
    evidence = f"{passed} of {len(tests)} runs within 2%, widest band {max(test.width for test in tests):.2%}"
    if seed_tests:
        passed = sum(bool(test.equivalent) for test in seed_tests)
        evidence += f"; {passed} of {len(seed_tests)} means over seeds, widest {max(t.width for t in seed_tests):.2%}"
    if all(test.equivalent for test in everything):
        grade = HOLDS
    else:
        grade = FAILS if any(map(_outside, everything)) else OPEN
    return grade_of(CLAIM, grade, evidence, CRITERION, chosen)


def _outside(test: Equivalence) -> bool:
    """Whether the whole interval lies beyond the margin."""
    return test.interval.low > test.margin or test.interval.high < -test.margin
