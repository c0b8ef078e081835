"""The models of N runs with stacked weights, and their N training losses in one evaluation."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields

import torch
from torch import Tensor, nn
from torch.func import functional_call, vmap

from dualhead_policy.flow.loss import LossWeights, flow_loss, training_loss
from dualhead_policy.model.dualhead_model import DualheadModel
from dualhead_policy.model.velocity_field import VelocityField
from dualhead_policy.training.stacked.field_kernel import Precision, StackableField
from dualhead_policy.training.stacked.step_inputs import step_draws


class StackedModel:
    """Models of equal shapes, whose parameters become views of stacked ones.

    The loss is :func:`dualhead_policy.flow.loss.training_loss` of one model under ``torch.vmap``, so that every
    mechanism is stacked by the code that defines it; the velocity fields take :mod:`.field_kernel`.

    Args:
        models: The models of N runs. Each keeps its parameters, which from now on share the stack's memory.
        precision: Type in which the velocity fields compute.

    Attributes:
        parameters: Stacked parameters (N, ...) by name.
    """

    def __init__(self, models: Sequence[DualheadModel], precision: Precision):
        self._models = models
        self.parameters: dict[str, Tensor] = {}
        for name, _ in models[0].named_parameters():
            own = [model.get_parameter(name) for model in models]
            stacked = torch.stack([parameter.detach() for parameter in own])
            for parameter, row in zip(own, stacked, strict=True):
                parameter.data = row
            self.parameters[name] = stacked.requires_grad_()
        self._buffers = {
            name: torch.stack([model.get_buffer(name) for model in models]) for name, _ in models[0].named_buffers()
        }
        weights = [LossWeights.of(model.config) for model in models]
        device = next(iter(self.parameters.values())).device
        self._weights = {
            field.name: torch.tensor([float(getattr(own, field.name)) for own in weights], device=device)
            for field in fields(LossWeights)
        }
        self._loss = _ModelLoss(models[0], precision)

    @contextmanager
    def in_own_memory(self, run: int) -> Iterator[None]:
        """One run's parameters out of the stack: safetensors refuses to save a part of a larger memory."""
        named = dict(self._models[run].named_parameters())
        for parameter in named.values():
            parameter.data = parameter.data.clone()
        try:
            yield
        finally:
            for name, parameter in named.items():
                parameter.data = self.parameters[name].data[run]

    def losses(self, inputs: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Training losses (N,), and the flow-matching losses' share of them (N,).

        Args:
            inputs: Windows and draws of every run's step, each (N, B, ...); see :mod:`.step_inputs`.
        """

        def one(parameters: Mapping[str, Tensor], buffers: Mapping[str, Tensor], weights: Mapping[str, Tensor], own):
            state = {f"model.{name}": value for name, value in (*parameters.items(), *buffers.items())}
            return functional_call(self._loss, state, (LossWeights(**weights), own))

        return vmap(one)(self.parameters, self._buffers, self._weights, dict(inputs))


class _ModelLoss(nn.Module):
    """One run's loss as a module, for ``functional_call``."""

    def __init__(self, model: DualheadModel, precision: Precision):
        super().__init__()
        self.model = copy.deepcopy(model)
        for head, field in list(self.model.network.fields.items()):
            assert isinstance(field, VelocityField)
            self.model.network.fields[head] = StackableField(field, precision)

    def forward(self, weights: LossWeights, inputs: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        observation, action, token = inputs["observation"], inputs["action"], inputs.get("token")
        loss, parts = training_loss(self.model, observation, action, token, step_draws(inputs), weights)
        return loss, flow_loss(parts)
