"""Train many runs as one program: each draws, learns and saves what it would have alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from dualhead_policy.training.stacked.field_kernel import Precision
from dualhead_policy.training.stacked.graphed_steps import GraphedSteps
from dualhead_policy.training.stacked.stacked_adam import StackedAdam
from dualhead_policy.training.stacked.stacked_model import StackedModel
from dualhead_policy.training.stacked.step_inputs import batch_inputs, draw_inputs, stacked
from dualhead_policy.training.trainer import Training


class StackedTraining:
    """N training runs, ready to make steps together.

    Every run keeps its own windows, order, draws, learning rate, clipping and checkpoints; weights, gradients and
    moments are stacked. The runs' policies and optimisers see the stack's memory: they can be measured and saved at
    any step.

    Args:
        trainings: The runs, of one stacking key (:mod:`.stacking_key`) and at one step.
        precision: Type in which the velocity fields compute; weights, gradients and moments are float32. ``"tf32"`` is
            float32 but for products on CUDA.

    Raises:
        ValueError: If the runs are not at one step.
    """

    def __init__(self, trainings: Sequence[Training], *, precision: Precision = "fp32"):
        steps = sorted({training.step for training in trainings})
        if len(steps) != 1:
            raise ValueError(f"the runs of a stack are at steps {steps}, expected one: continue each alone")
        self.trainings = trainings
        self._model = StackedModel([training.policy.model for training in trainings], precision)
        self._parameters = list(self._model.parameters.values())
        self._optimizer = StackedAdam(
            self._model.parameters,
            [training.optimizer for training in trainings],
            [training.grad_clip_norm for training in trainings],
        )

        self._graphed: GraphedSteps | None = None

    @property
    def step(self) -> int:
        """Steps made so far."""
        return self.trainings[0].step

    def update(self) -> Tensor:
        """One optimiser step of every run; returns losses and the flow-matching losses' share of them (2, N)."""
        inputs = []
        for training in self.trainings:
            batch = training.source.batch(self.step)
            draws = training.policy.draw_step(batch.observation, batch.action, has_tokens=batch.token is not None)
            inputs.append(batch_inputs(batch) | draw_inputs(draws))
        loss, flow = self._model.losses(stacked(inputs))
        gradients = torch.autograd.grad(loss.sum(), self._parameters, materialize_grads=True)
        self._optimizer.step(gradients)
        for training in self.trainings:
            training.advance()
        return torch.stack([loss.detach(), flow.detach()])

    def updates(self, count: int) -> Tensor:
        """``count`` optimiser steps of every run: what :meth:`update` makes, on CUDA from a recorded graph.

        Returns:
            Losses and the flow-matching losses' share of them (count, 2, N).
        """
        if self._parameters[0].device.type != "cuda":
            return torch.stack([self.update() for _ in range(count)])
        if self._graphed is None:
            self._graphed = GraphedSteps(self.trainings, self._model, self._optimizer)
        losses = self._graphed.run(count)
        for training in self.trainings:
            training.advance(count)
        return losses

    def close(self) -> None:
        """Leave the runs as they are, ready to go on in another stack or alone."""
        self._optimizer.write_counts()
        if self._graphed is not None:
            self._graphed.close()
            self._graphed = None

    def stage(self) -> list[Path]:
        """Assemble a checkpoint of every run at the current step; returns their places once they are published."""
        self._optimizer.write_counts()
        places = []
        for run, training in enumerate(self.trainings):
            with self._model.in_own_memory(run):
                places.append(training.stage())
        return places
