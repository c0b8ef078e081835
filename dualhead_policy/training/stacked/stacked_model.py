"""The models of N runs with stacked weights, and their N training losses in one evaluation."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields

import torch
from torch import Tensor, nn
from torch.func import functional_call, vmap

from dualhead_policy.flow.draws import StepDraws
from dualhead_policy.flow.loss import LossWeights, flow_loss, training_loss
from dualhead_policy.model.dualhead_model import DualheadModel
from dualhead_policy.model.tokens import TokenCorruption
from dualhead_policy.model.velocity_field import VelocityField
from dualhead_policy.training.stacked.field_kernel import StackableField
from dualhead_policy.training.window_sources import Batch


class StackedModel:
    """Models of equal shapes, whose parameters become views of stacked ones.

    The loss is :func:`dualhead_policy.flow.loss.training_loss` of one model under ``torch.vmap``, so that every
    mechanism is stacked by the code that defines it; the velocity fields take :mod:`.field_kernel`.

    Args:
        models: The models of N runs. Each keeps its parameters, which from now on share the stack's memory.
        compute_dtype: Type in which the velocity fields compute.

    Attributes:
        parameters: Stacked parameters (N, ...) by name.
    """

    def __init__(self, models: Sequence[DualheadModel], compute_dtype: torch.dtype):
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
        self._loss = _ModelLoss(models[0], compute_dtype)

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

    def losses(self, batches: Sequence[Batch], draws: Sequence[StepDraws]) -> tuple[Tensor, Tensor]:
        """Training losses (N,), and the flow-matching losses' share of them (N,).

        Args:
            batches: The batch of every run, all of one size.
            draws: The draws of every run's step.
        """
        inputs = {
            "observation": torch.stack([batch.observation for batch in batches]),
            "action": torch.stack([batch.action for batch in batches]),
            "token": _stack([batch.token for batch in batches]),
            "time": torch.stack([draw.time for draw in draws]),
            "source": {head: torch.stack([draw.source[head] for draw in draws]) for head in draws[0].source},
            "observation_noise": _stack([draw.observation_noise for draw in draws]),
            "latent": _stack([draw.latent for draw in draws]),
            "chance": _stack([draw.corruption.chance if draw.corruption else None for draw in draws]),
            "replacement": _stack([draw.corruption.replacement if draw.corruption else None for draw in draws]),
        }
        given = {name: value for name, value in inputs.items() if value is not None}

        def one(parameters: Mapping[str, Tensor], buffers: Mapping[str, Tensor], weights: Mapping[str, Tensor], own):
            state = {f"model.{name}": value for name, value in (*parameters.items(), *buffers.items())}
            return functional_call(self._loss, state, (LossWeights(**weights),), own)

        return vmap(one)(self.parameters, self._buffers, self._weights, given)


class _ModelLoss(nn.Module):
    """One run's loss as a module, for ``functional_call``."""

    def __init__(self, model: DualheadModel, compute_dtype: torch.dtype):
        super().__init__()
        self.model = copy.deepcopy(model)
        for head, field in list(self.model.network.fields.items()):
            assert isinstance(field, VelocityField)
            self.model.network.fields[head] = StackableField(field, compute_dtype)

    def forward(
        self,
        weights: LossWeights,
        *,
        observation: Tensor,
        action: Tensor,
        time: Tensor,
        source: Mapping[str, Tensor],
        token: Tensor | None = None,
        observation_noise: Tensor | None = None,
        latent: Tensor | None = None,
        chance: Tensor | None = None,
        replacement: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        corruption = None if chance is None or replacement is None else TokenCorruption(chance, replacement)
        draws = StepDraws(time, dict(source), observation_noise, corruption, latent)
        loss, parts = training_loss(self.model, observation, action, token, draws, weights)
        return loss, flow_loss(parts)


def _stack(tensors: Sequence[Tensor | None]) -> Tensor | None:
    given = [tensor for tensor in tensors if tensor is not None]
    return torch.stack(given) if given else None
