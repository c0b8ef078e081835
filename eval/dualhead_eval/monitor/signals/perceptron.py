"""A multilayer perceptron trained with torch and evaluated in NumPy, one observation in microseconds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

EPOCHS, LEARNING_RATE, BATCH = 250, 1e-3, 128

Layers = list[tuple[NDArray[np.float64], NDArray[np.float64]]]


def orthogonal_network(widths: Sequence[int], generator: torch.Generator) -> nn.Sequential:
    """Linear layers of these widths with ReLU between them, orthogonal weights and zero biases."""
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        linear = nn.Linear(before, after)
        nn.init.orthogonal_(linear.weight, generator=generator)
        nn.init.zeros_(linear.bias)
        layers += [linear, nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def train(
    network: nn.Module, rows: Tensor, loss: Callable[[Tensor], Tensor], generator: torch.Generator, epochs: int
) -> None:
    """Minimise ``loss`` of batches of ``rows`` (N, D) with AdamW."""
    optimiser = torch.optim.AdamW(network.parameters(), lr=LEARNING_RATE)
    for _ in range(epochs):
        for batch in torch.randperm(len(rows), generator=generator).split(BATCH):
            optimiser.zero_grad()
            loss(rows[batch]).backward()
            optimiser.step()


def layers_of(network: nn.Sequential) -> Layers:
    """Weights ``(out, in)`` and biases of the linear layers, in double precision."""
    linear = [layer for layer in network if isinstance(layer, nn.Linear)]
    return [
        (layer.weight.detach().double().numpy().copy(), layer.bias.detach().double().numpy().copy()) for layer in linear
    ]


def forward(layers: Layers, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Output ``(out,)`` of one input ``(in,)``."""
    for weight, bias in layers[:-1]:
        x = np.maximum(weight @ x + bias, 0.0)
    weight, bias = layers[-1]
    return weight @ x + bias


def named(layers: Layers, prefix: str) -> dict[str, NDArray]:
    """Layers as arrays by name."""
    return {
        f"{prefix}.{i}.{kind}": array for i, pair in enumerate(layers) for kind, array in zip("wb", pair, strict=True)
    }


def unnamed(arrays: dict[str, NDArray], prefix: str) -> Layers:
    """Layers from arrays that :func:`named` named."""
    count = sum(name.startswith(f"{prefix}.") and name.endswith(".w") for name in arrays)
    return [(arrays[f"{prefix}.{i}.w"], arrays[f"{prefix}.{i}.b"]) for i in range(count)]
