"""Recorded rollouts, read back: what became of the episodes, and the counts of both heads' predictions.

:mod:`dualhead_eval.evaluation.closed_loop` says how they are recorded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from dualhead_envs.dataset_sidecar import ROLLOUTS_KIND, ROLLOUTS_REMEDY, checked_rollouts, read_rollout_sidecar
from dualhead_envs.validated_json import parse_json
from dualhead_eval.evaluation.labelled_pairs import LabelledPairs, make_gate
from dualhead_eval.gate.compressed import COMPRESSED_SUFFIX, decompress, is_compressed
from dualhead_eval.gate.gate import ROLLOUTS, Gate
from dualhead_eval.statistics.interval import Interval

#: Format of a rollout dataset's ``meta/dualhead.json``.
ROLLOUTS_FORMAT = "dualhead-rollouts/1"
#: How the name of a copy of it ends.
ROLLOUTS_SUFFIX = ".rollouts.json"
#: The same, plain or compressed.
ROLLOUTS_SUFFIXES = (ROLLOUTS_SUFFIX, ROLLOUTS_SUFFIX + COMPRESSED_SUFFIX)


@dataclass(frozen=True)
class ModeOutcome:
    """What became of the episodes whose path was of one mode.

    Attributes:
        mode: The mode, -1 for none.
        episodes: Episodes of it.
        successes: Those that ended in success.
    """

    mode: int
    episodes: int
    successes: int

    @property
    def success_interval(self) -> Interval:
        """95% interval of the success rate among them (Wilson 1927); 0 to 1 without any."""
        return wilson_interval(self.successes, self.episodes)


@dataclass(frozen=True)
class ClosedLoop:
    """Outcomes of closed-loop episodes from initial states that no demonstration began from.

    Attributes:
        env_id: Environment.
        control: What drove: ``"joint"``, ``"position"`` or ``"pose"``.
        episodes: Episodes rolled out.
        successes: Episodes that ended in success.
        collisions: Episodes that ended in a collision.
        refusals: One sentence per episode that ended because a decision was refused; they count as failures.
        modes: The same, mode by mode, and last for the episodes of no mode.
    """

    env_id: str
    control: str
    episodes: int
    successes: int
    collisions: int
    refusals: tuple[str, ...] = ()
    modes: tuple[ModeOutcome, ...] = ()

    @property
    def success_rate(self) -> float:
        """Share of episodes that ended in success."""
        return self.successes / self.episodes

    @property
    def success_interval(self) -> Interval:
        """95% interval of the success rate (Wilson 1927)."""
        return wilson_interval(self.successes, self.episodes)

    def __str__(self) -> str:
        low, high = self.success_interval.low, self.success_interval.high
        return (
            f"{self.control} head driving: success {self.successes} of {self.episodes} = {self.success_rate:.1%} "
            f"[{low:.1%}, {high:.1%}], collision {self.collisions} of {self.episodes}"
            + (f", refused {len(self.refusals)} of {self.episodes}" if self.refusals else "")
        )


def wilson_interval(successes: int, trials: int) -> Interval:
    """95% interval of a share (Wilson 1927); 0 to 1 if there was no trial."""
    if trials == 0:
        return Interval(0.0, 1.0, 0.95)
    bounds = binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    return Interval(float(bounds.low), float(bounds.high), 0.95)


def closed_loop_of(sidecar: Mapping[str, Any]) -> ClosedLoop | None:
    """The outcomes in the ``meta/dualhead.json`` of recorded rollouts; None if it holds none."""
    if "outcomes" not in sidecar:
        return None
    outcomes = sidecar["outcomes"]
    return ClosedLoop(
        env_id=sidecar["env_id"],
        control=sidecar["env_kwargs"]["control"],
        episodes=len(outcomes),
        successes=sum(outcome["success"] for outcome in outcomes),
        collisions=sum(outcome["collision"] for outcome in outcomes),
        refusals=tuple(
            f"episode {number} (seed {outcome['seed']}) was refused after {outcome['frames']} steps: "
            f"{outcome['refused']}"
            for number, outcome in enumerate(outcomes)
            if outcome.get("refused")
        ),
        modes=tuple(_mode_outcome(outcomes, mode) for mode in (*range(sidecar["partition"]["n_modes"]), -1)),
    )


def _mode_outcome(outcomes: Sequence[Mapping[str, Any]], mode: int) -> ModeOutcome:
    own = [outcome for outcome in outcomes if outcome["mode"] == mode]
    return ModeOutcome(mode, len(own), sum(outcome["success"] for outcome in own))


def read_closed_loop(path: str | Path) -> tuple[str, ClosedLoop]:
    """Name and outcomes of recorded rollouts.

    Args:
        path: A rollout dataset's folder, or a copy of its ``meta/dualhead.json`` (``NAME.rollouts.json``, or the same
            with ``.gz``), which is small enough to keep.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is of another kind.
    """
    path = Path(path)
    file = path / "meta" / "dualhead.json" if path.is_dir() else path
    sidecar = read_outcomes(file)
    loop = closed_loop_of(sidecar)
    assert loop is not None
    name = path.name.removesuffix(COMPRESSED_SUFFIX).removesuffix(ROLLOUTS_SUFFIX)
    step = sidecar.get("policy", {}).get("training_step")
    return (f"{name}, {step} steps" if step else name), loop


def read_outcomes(path: Path) -> dict[str, Any]:
    """The checked content of a rollout dataset's ``meta/dualhead.json``, or of a copy of it, plain or compressed.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is damaged or of another kind.
    """
    if not is_compressed(path) or not path.is_file():
        return read_rollout_sidecar(path)
    text = decompress(path, kind=ROLLOUTS_KIND, remedy=ROLLOUTS_REMEDY)
    return checked_rollouts(parse_json(text, source=str(path), kind=ROLLOUTS_KIND, remedy=ROLLOUTS_REMEDY), path)


def rollout_gate(root: str | Path, *, taus: Sequence[float] = (), label: str | None = None) -> Gate:
    """Count the predictions of a rollout dataset: every decision is a condition of its own.

    Pairs that follow what the episode holds are left out: they are no draws of their decision.

    Raises:
        FileNotFoundError: If there is no dataset.
        ValueError: If it holds no pairs of predictions, or does not say which pairs are held.
    """
    from dualhead_eval.evaluation.recorded_decisions import read_decisions

    root = Path(root)
    decisions = read_decisions(root)
    sidecar, fresh = decisions.sidecar, slice(decisions.held, None)
    pairs = LabelledPairs.from_paths(
        decisions.joint[:, fresh],
        decisions.position[:, fresh],
        decisions.condition,
        decisions.partition,
        heads=decisions.heads,
    )
    nfe = sidecar["num_inference_steps"]
    return make_gate(
        {nfe: pairs},
        reference_nfe=nfe,
        taus=taus,
        conditions=decisions.condition,
        pair_ids=decisions.episode,
        partition=decisions.partition,
        target_probabilities=None,
        provenance={"label": label or root.name, "method": ROLLOUTS, "rollouts": sidecar},
    )
