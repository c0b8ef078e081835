"""Hooks that are shown every decision of a policy in closed loop: its observations, and sampled pairs of both heads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Protocol
from weakref import WeakSet

import torch
from torch import Tensor

from dualhead_policy.disagreement_step import begin_episodes
from dualhead_policy.sampling import HeadSamples

#: Seed of the further pairs' draws at the beginning of every episode.
FURTHER_SEED = 20260802


class DecisionHook(Protocol):
    """What a policy's ``decision_hooks`` hold."""

    def reset(self) -> None:
        """An episode begins in every row."""

    def __call__(self, batch: Mapping[str, Tensor], samples: HeadSamples) -> None:
        """See a decision.

        Args:
            batch: Preprocessed observations of B rows.
            samples: ``monitor_samples`` pairs per row in physical units, the executed one first.
        """


class DecisionListener(Protocol):
    """What listens to every policy of its process, as a processor step does: LeRobot makes it without its policy."""

    def decided(self, policy: Any, batch: Mapping[str, Tensor]) -> None:
        """A policy decides under preprocessed observations of B rows; its own random numbers are to be left alone."""


#: Listeners of this process, for as long as somebody holds them.
LISTENERS: WeakSet[DecisionListener] = WeakSet()


class DecisionHooks(list[DecisionHook]):
    """The hooks of one policy.

    Further pairs have a generator of their own: a policy that is watched executes what it would have executed.
    """

    def begin(self) -> None:
        """Begin an episode in every row."""
        begin_episodes()
        self._generator = torch.Generator().manual_seed(FURTHER_SEED)
        for hook in self:
            hook.reset()

    def show(self, policy: Any, batch: Mapping[str, Tensor], executed: HeadSamples) -> None:
        """Show a decision to every hook, ``policy.monitor_samples`` pairs of it, and to every listener."""
        for listener in list(LISTENERS):
            listener.decided(policy, batch)
        if not self:
            return
        samples = executed
        if policy.monitor_samples > 1:
            further = policy.sample(batch, policy.monitor_samples - 1, generator=self._generator)
            joined: dict[str, Any] = {f.name: _joined(f.name, executed, further) for f in fields(HeadSamples)}
            samples = HeadSamples(**joined)
        for hook in self:
            hook(batch, samples)


def _joined(name: str, executed: HeadSamples, further: HeadSamples) -> Tensor | None:
    first, others = getattr(executed, name), getattr(further, name)
    if name == "gripper" or first is None:  # one command a row, whatever is sampled
        return first
    return torch.cat([first, others], dim=1)
