"""What a step of N stacked runs needs, as named tensors: windows and draws, with a leading run axis once stacked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from dualhead_policy.flow.draw_rule import StepDraws
from dualhead_policy.model.token_corruption import TokenCorruption
from dualhead_policy.training.batch import Batch

#: Named tensors of one run's step, (B, ...), or of all runs', (N, B, ...).
StepInputs = dict[str, Tensor]
#: First frames of recorded windows, in place of the windows themselves.
START = "start"
_SOURCE = "source."


def batch_inputs(batch: Batch) -> StepInputs:
    """Windows by name."""
    given = {"observation": batch.observation, "action": batch.action, "token": batch.token}
    return {name: value for name, value in given.items() if value is not None}


def draw_inputs(draws: StepDraws) -> StepInputs:
    """Draws by name."""
    given = {"time": draws.time, "observation_noise": draws.observation_noise, "latent": draws.latent}
    if draws.corruption is not None:
        given |= {"chance": draws.corruption.chance, "replacement": draws.corruption.replacement}
    given |= {_SOURCE + head: value for head, value in draws.source.items()}
    return {name: value for name, value in given.items() if value is not None}


def step_draws(inputs: Mapping[str, Tensor]) -> StepDraws:
    """The draws among named tensors."""
    source = {name.removeprefix(_SOURCE): value for name, value in inputs.items() if name.startswith(_SOURCE)}
    corruption = TokenCorruption(inputs["chance"], inputs["replacement"]) if "chance" in inputs else None
    return StepDraws(inputs["time"], source, inputs.get("observation_noise"), corruption, inputs.get("latent"))


def stacked(inputs: Sequence[StepInputs]) -> StepInputs:
    """Inputs of all runs, of one size of batch, (N, B, ...)."""
    return {name: torch.stack([own[name] for own in inputs]) for name in inputs[0]}
