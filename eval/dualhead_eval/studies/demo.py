"""The demo's plans: on the ring, couplings beside the exact reference; on the robots, couplings on two obstacles."""

from __future__ import annotations

from dualhead_eval.studies.plan import Budget, Plan, PlannedDataset, PlannedPolicy, PlannedRow

RING_PLAN = Plan(
    what_is_recorded="{n:,} scripted paths under each of two representation maps",
    budgets={
        "smoke": Budget(demonstrations=10_000, steps=3_000, save_freq=1_000, pairs=256),
        "full": Budget(demonstrations=50_000, steps=20_000, save_freq=5_000, pairs=1_280),
    },
    datasets=(
        PlannedDataset("nullspace", "RotatingRing-v2", {"representation": "nullspace"}),
        PlannedDataset("polar", "RotatingRing-v2", {"representation": "polar"}),
    ),
    policies=(
        PlannedPolicy("nullspace", "nullspace"),
        PlannedPolicy("polar", "polar"),
        PlannedPolicy("oracle-token", "nullspace", ("--policy.token=oracle",)),
        PlannedPolicy("window-token", "nullspace", ("--policy.token=window", "--policy.n_tokens=2")),
    ),
    rows=(
        PlannedRow(
            "independent",
            "independent noise",
            "nullspace",
            "The floor: each head picks a mode on its own, so they agree exactly as often as chance.",
        ),
        PlannedRow(
            "shared-noise-nullspace",
            "shared noise, nullspace map",
            "nullspace",
            "Anti-coordination: the same network with shared noise; this map turns the noise around, so the "
            "heads avoid each other's mode.",
            source_noise_beta=0.0,
        ),
        PlannedRow(
            "shared-noise-polar",
            "shared noise, polar map",
            "polar",
            "Coordination: the same trick under another map makes them agree. What shared noise does depends "
            "on the representation.",
            source_noise_beta=0.0,
        ),
        PlannedRow(
            "window-token",
            "shared k-means token",
            "window-token",
            "Towards the corner: a token found without labels, shared by both heads.",
            reference=None,
        ),
        PlannedRow(
            "oracle-token",
            "shared oracle token",
            "oracle-token",
            "The corner: both heads follow one token that names the mode; they always agree, and both modes "
            "stay alive.",
            reference={"token": "oracle"},
        ),
    ),
)


def _robot_plan(env_id: str, obstacle: str) -> Plan:
    return Plan(
        what_is_recorded="{n:,} pairs of scripted demonstrations, one past each side of the " + obstacle,
        budgets={
            "smoke": Budget(demonstrations=100, steps=3_000, save_freq=1_000, pairs=256),
            "full": Budget(demonstrations=500, steps=20_000, save_freq=5_000, pairs=1_280),
        },
        datasets=(PlannedDataset("demonstrations", env_id, {}, size="pairs"),),
        policies=(
            PlannedPolicy("no-token", "demonstrations"),
            PlannedPolicy("oracle-token", "demonstrations", ("--policy.token=oracle",)),
            PlannedPolicy("episode-token", "demonstrations", ("--policy.token=episode", "--policy.n_tokens=2")),
        ),
        rows=(
            PlannedRow(
                "independent",
                "independent noise",
                "no-token",
                "The floor: each head picks a side on its own. The heads disagree about half of the time, and "
                "nothing is wrong.",
                reference=None,
            ),
            PlannedRow(
                "shared-noise",
                "shared noise",
                "no-token",
                "The same network with shared noise: what that does depends on the arm's kinematics.",
                source_noise_beta=0.0,
                reference=None,
            ),
            PlannedRow(
                "episode-token",
                "shared k-means token",
                "episode-token",
                "A token found without labels, by clustering whole demonstrations, shared by both heads.",
                reference=None,
            ),
            PlannedRow(
                "oracle-token",
                "shared oracle token",
                "oracle-token",
                "The corner: one token names the side and both heads follow it, with both sides alive.",
                reference=None,
            ),
        ),
    )


#: Plans by the name that ``--env`` takes.
PLANS = {
    "ring": RING_PLAN,
    "v2": _robot_plan("BimodalBypass-v2", "wall"),
    "v3": _robot_plan("RotatingBypass-v3", "beam"),
}
