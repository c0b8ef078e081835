"""Cost of a failure monitor: ``uv run python benchmarks/monitor.py``.

Time of every signal on one decision beyond its samples (sampling itself: benchmarks/decision_latency.py), of making
the decision, and of a monitor that runs all of them; then how many times faster than real time a recording is scored.
CPU time, the best of several repeats, on one thread, at the sizes of BimodalBypass-v2: 16 pairs of 16 steps, 7 joints.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy: small matrices on one thread

import time
from collections.abc import Callable

import numpy as np

from dualhead_envs.bypass.partition import BimodalPartition
from dualhead_eval.monitor.decision import Decision, Episode
from dualhead_eval.monitor.decision_builder import SITES, DecisionBuilder
from dualhead_eval.monitor.monitor import Monitor
from dualhead_eval.monitor.signals import SIGNALS, make_signal

PAIRS, HORIZON, STATE, CONTEXT = 16, 16, 24, 18
#: Steps between decisions, and control steps per second of real time.
EXECUTED, RATE = 8, 20
#: Limits in ms beyond the samples: the residual of one pair, and all signals together.
LIMITS = {"residual": 0.3, "all": 1.0}


def best(action: Callable[[], object], calls: int = 200, repeats: int = 7) -> float:
    """Smallest CPU time of one call, in ms."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        for _ in range(calls):
            action()
        times.append(time.process_time() - start)
    return 1000 * min(times) / calls


def make_decisions(builder: DecisionBuilder, rng: np.random.Generator, count: int, pairs: int) -> list[Decision]:
    """Decisions at random observations."""
    return [
        builder.build(
            EXECUTED * step,
            rng.standard_normal(STATE).astype(np.float32),
            rng.standard_normal(CONTEXT).astype(np.float32),
            rng.uniform(-1, 1, (pairs, HORIZON, 7)).astype(np.float32),
            rng.uniform(-0.3, 0.3, (pairs, HORIZON, 3)).astype(np.float32),
        )
        for step in range(count)
    ]


def main() -> None:
    """Time each and print it beside its limit."""
    rng = np.random.default_rng(0)
    names = [*SITES[0], *(f"other.{i}" for i in range(STATE - 3))]
    bare = DecisionBuilder("panda", names, "joint")
    full = DecisionBuilder("panda", names, "joint", BimodalPartition())
    decisions = make_decisions(full, rng, 25, PAIRS)
    one, many = (
        (d.observation[:STATE], d.observation[STATE:], d.joint[:n], d.position[:n])
        for d in decisions[:1]
        for n in (1, PAIRS)
    )

    residual = make_signal("residual")
    lines = [
        (
            "decision of one pair and its residual",
            best(lambda: residual.score(bare.build(0, *one))),
            LIMITS["residual"],
        ),
        ("decision of 16 pairs", best(lambda: bare.build(0, *many)), None),
        ("decision of 16 pairs with their labels", best(lambda: full.build(0, *many)), None),
    ]
    monitored = [name for name, kind in SIGNALS.items() if "members" not in kind.needs]
    fitted = []
    for name in monitored:
        signal = make_signal(name, epochs=1) if name in ("rnd", "logpzo") else make_signal(name)
        signal.fit(decisions, rng)
        signal.score(decisions[0])
        lines.append((f"signal {name}", best(lambda s=signal: s.score(decisions[1])), None))
        fitted.append(signal)
    episodes = [Episode(tuple(decisions), True, steps=EXECUTED * len(decisions), key=str(i)) for i in range(29)]
    monitor = Monitor(fitted).fit(episodes, rng=rng)
    per_decision = best(lambda: monitor.read(episodes[0]), calls=2) / len(decisions)
    lines.append((f"monitor of all {len(monitored)} signals, per decision", per_decision, LIMITS["all"]))
    for name, milliseconds, limit in lines:
        print(f"{name:48s} {milliseconds:9.4f} ms" + (f"   (limit {limit} ms)" if limit else ""))

    def score_offline() -> None:
        monitor.reset()
        for d in decisions:
            built = full.build(d.step, d.observation[:STATE], d.observation[STATE:], d.joint, d.position)
            monitor.update(built)

    seconds = best(score_offline, calls=1) / 1000
    print(
        f"{'offline scoring, times real time':48s} {len(decisions) * EXECUTED / RATE / seconds:9.0f}      (at least 20)"
    )


if __name__ == "__main__":
    main()
