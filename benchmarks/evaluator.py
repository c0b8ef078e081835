"""Speed of the evaluator's core: ``uv run python benchmarks/evaluator.py``.

Prints the best of several repeats of CPU time, which other programs on the machine disturb least.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from dualhead_eval.certificate.certificate import CoordinationCertificate
from dualhead_eval.effects.contingency import coordination
from dualhead_eval.effects.counts import joint_counts
from dualhead_eval.statistics.bootstrap import bootstrap_conditions
from dualhead_eval.statistics.run_statistics import condition_sums


def best(action: Callable[[], object], repeats: int = 5) -> float:
    """Smallest CPU time of ``action`` in seconds."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        action()
        times.append(time.process_time() - start)
    return min(times)


def main() -> None:
    """Time each measure and print it beside its limit."""
    rng = np.random.default_rng(0)
    tables = rng.integers(0, 1000, size=(1_000_000, 2, 2))
    a, b = rng.integers(0, 2, size=(2, 75, 1280))
    counts = joint_counts(a, b, 2)
    decisions = rng.integers(0, 2, size=(2, 50_000, 2))
    few = rng.integers(0, 2, size=(2, 5000, 1))

    def single() -> None:
        certificate = CoordinationCertificate()
        for x, y in zip(*few, strict=True):
            certificate.update(x, y)

    def verdicts() -> None:
        certificate = CoordinationCertificate()
        for i in range(1000):
            certificate.update(decisions[0, i : i + 1], decisions[1, i : i + 1])
            _ = certificate.verdict

    lines = [
        ("coordination() of 1,000,000 2x2 tables", best(lambda: coordination(tables)), "s", "1"),
        (
            "2000 bootstrap draws of 75 conditions",
            best(lambda: bootstrap_conditions(condition_sums(counts))),
            "s",
            "0.2",
        ),
        (
            "certificate, batched, per pair",
            1e6 * best(lambda: CoordinationCertificate().update(*decisions)) / decisions[0].size,
            "us",
            "10",
        ),
        ("certificate, single pair", 1e6 * best(single) / few[0].size, "us", "50"),
        ("certificate, decision of two pairs and verdict", 1e6 * best(verdicts, 3) / 1000, "us", "-"),
    ]
    for name, value, unit, limit in lines:
        print(f"{name:48s} {value:9.3f} {unit:2s}   (limit {limit})")


if __name__ == "__main__":
    main()
