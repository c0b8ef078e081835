"""A fitted monitor beside any closed loop of a policy: ``with watch(policy, monitor, preprocess):``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from typing import Any

import numpy as np
import torch
from lerobot.processor import NormalizerProcessorStep, TransitionKey, UnnormalizerProcessorStep
from torch import Tensor

from dualhead_eval.monitor.branch_flag import BranchFlag
from dualhead_eval.monitor.decision_builder import DecisionBuilder
from dualhead_eval.monitor.monitor import Monitor, Reading
from dualhead_eval.monitor.recorded_episodes import OBSERVATIONS
from dualhead_policy.modeling_dualhead import DualheadPolicy
from dualhead_policy.sampling import HeadSamples


class Watch:
    """What a monitor said of every decision since the policy's last reset.

    Attributes:
        readings: A list of readings for every row of the policy's batch.
    """

    def __init__(self, policy: DualheadPolicy, monitor: Monitor, unnormalise: Any, builder: DecisionBuilder) -> None:
        self._policy, self._monitor, self._unnormalise, self._builder = policy, monitor, unnormalise, builder
        self._rows: list[Monitor] = []
        self.readings: list[list[Reading]] = []

    @property
    def alarms(self) -> list[bool]:
        """Whether each row has raised an alarm."""
        return [bool(row) and row[-1].alarm for row in self.readings]

    def reset(self) -> None:
        """Begin an episode in every row."""
        self._rows, self.readings = [], []

    def __call__(self, batch: Mapping[str, Tensor], samples: HeadSamples) -> None:
        """Read a decision in every row."""
        if len(self._rows) != len(samples.joint):
            self._rows = [deepcopy(self._monitor) for _ in samples.joint]
            self.readings = [[] for _ in samples.joint]
            for monitor in self._rows:
                monitor.reset()
        raw = self._unnormalise(batch)
        joint, position = samples.joint.cpu().numpy(), samples.position.cpu().numpy()
        steps = self._policy.config.n_action_steps or 1
        for row, monitor in enumerate(self._rows):
            decision = self._builder.build(
                steps * len(self.readings[row]),
                raw[OBSERVATIONS[0]][row],
                raw[OBSERVATIONS[1]][row],
                joint[row],
                position[row],
                diverged=None if samples.diverged is None else samples.diverged[row].cpu().numpy(),
            )
            self.readings[row].append(monitor.update(decision))


@contextmanager
def watch(
    policy: DualheadPolicy,
    monitor: Monitor,
    preprocess: Any,
    *,
    samples: int | None = None,
    control: str = "joint",
    state_names: list[str] | None = None,
    partition: Any = None,
    flag: BranchFlag | None = None,
) -> Iterator[Watch]:
    """Let a monitor read every decision that ``policy.select_action`` makes inside the block.

        with watch(policy, monitor, preprocess) as watched:
            ...any rollout...
            watched.alarms

    The policy executes what it would have executed. Observations are taken back through the preprocessor's
    normalisation, in single precision.

    Args:
        policy: The policy.
        monitor: A fitted monitor; every row of a batch has a copy of it.
        preprocess: The policy's preprocessor.
        samples: Pairs per decision; by default one, or 16 where a signal compares several.
        control: The head whose chunks are executed.
        state_names: Names of the proprioception's dimensions, for signals of the measured position.
        partition: A mode partition, for signals of mode labels.
        flag: Says of an observation whether two modes are open, for Mondrian thresholds.

    Raises:
        ValueError: If the monitor has not been fitted, or the preprocessor does not normalise.
    """
    if monitor.alpha is None:
        raise ValueError("the monitor has no threshold yet, expected a fitted one: call fit, or load_monitor")
    several = any("samples" in channel.signal.needs for channel in monitor.channels)
    builder = DecisionBuilder(policy.representation.kinematic_map, state_names, control, partition, flag)
    watched = Watch(policy, monitor, _unnormaliser(preprocess), builder)
    before = policy.monitor_samples
    policy.monitor_samples = samples or (16 if several else 1)
    policy.decision_hooks.append(watched)
    try:
        yield watched
    finally:
        policy.decision_hooks.remove(watched)
        policy.monitor_samples = before


def _unnormaliser(preprocess: Any) -> Any:
    """From a preprocessed batch back to raw observations ``(B, D)`` by key."""
    steps = [step for step in getattr(preprocess, "steps", ()) if isinstance(step, NormalizerProcessorStep)]
    if len(steps) != 1:
        raise ValueError(
            "the preprocessor has no normalisation to undo, expected the policy's own: give what load_policy returns"
        )
    inverse = UnnormalizerProcessorStep(features=steps[0].features, norm_map=steps[0].norm_map, stats=steps[0].stats)

    def raw(batch: Mapping[str, Tensor]) -> dict[str, np.ndarray]:
        observation = {key: batch[key].cpu() for key in OBSERVATIONS}
        with torch.no_grad():
            undone = inverse({TransitionKey.OBSERVATION: observation})[TransitionKey.OBSERVATION]
        return {key: undone[key].numpy() for key in OBSERVATIONS}

    return raw
