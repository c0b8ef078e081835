"""The condition encoder and a head's velocity field.

A velocity field is evaluated in two parts, so that sampling many chunks for one condition pays for the
conditioning once: :meth:`VelocityField.modulation` turns (time, condition, token) into what each layer needs,
and :meth:`VelocityField.forward` applies it to the noisy chunk.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

#: What the layers of a velocity field need to know of time and context.
Modulation = list[Tensor]
#: Width of the bottleneck through which the FiLM modulation is computed.
FILM_BOTTLENECK = 64


def time_features(time: Tensor, n_frequencies: int) -> Tensor:
    """Sinusoidal features of flow time at the low frequencies 1..n (in half turns over [0, 1]).

    Args:
        time: Flow time in [0, 1], shape (...,).
        n_frequencies: Number of frequencies.

    Returns:
        Features (..., 2 * n_frequencies): sines, then cosines.
    """
    angles = time[..., None] * (torch.pi * torch.arange(1, n_frequencies + 1, device=time.device))
    return torch.cat([angles.sin(), angles.cos()], dim=-1)


class ConditionEncoder(nn.Module):
    """E(c): observation (..., C) -> embedding (..., width), two layers, shared by the heads (sec:heads).

    Args:
        observation_dim: Size of the observation.
        width: Size of the embedding.
        gain: Factor on the embedding; see ``DualheadConfig.embedding_gain``.
    """

    def __init__(self, observation_dim: int, width: int, gain: float):
        super().__init__()
        self.gain = gain
        self.layers = nn.Sequential(nn.Linear(observation_dim, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU())

    def forward(self, observation: Tensor) -> Tensor:
        return self.layers(observation) * self.gain


class VelocityField(nn.Module):
    """v(x, t, E(c), z): an MLP over the flattened chunk (sec:models: four layers of 256 units).

    Args:
        chunk_dim: Flattened size of the chunk, H * d.
        context_dim: Size of the context, E(c) with the token (or latent) appended.
        width: Units in each hidden layer.
        n_layers: Hidden layers.
        n_frequencies: Frequencies of the time features.
        conditioning: ``"concat"``, the paper's construction: [x, t, context] enters the first layer; or
            ``"film"``: time and context scale and shift the pre-activations of every layer.
    """

    def __init__(
        self,
        chunk_dim: int,
        context_dim: int,
        *,
        width: int,
        n_layers: int,
        n_frequencies: int,
        conditioning: str,
    ):
        super().__init__()
        self.n_frequencies = n_frequencies
        self.conditioning = conditioning
        self.input = nn.Linear(chunk_dim, width)
        self.hidden = nn.ModuleList(nn.Linear(width, width) for _ in range(n_layers - 1))
        self.output = nn.Linear(width, chunk_dim)
        side_dim = 2 * n_frequencies + context_dim
        if conditioning == "concat":
            # W [x, t, context] = W_x x + W_s [t, context]: the second product is shared by all samples of a
            # condition. Both halves start as one dense layer of the concatenated input would.
            side = nn.Linear(side_dim, width, bias=False)
            bound = (chunk_dim + side_dim) ** -0.5
            for parameter in (self.input.weight, self.input.bias, side.weight):
                nn.init.uniform_(parameter, -bound, bound)
            self.side = nn.ModuleList([side])
        else:
            self.bottleneck = nn.Sequential(nn.Linear(side_dim, FILM_BOTTLENECK), nn.SiLU())
            # Scale and shift of every layer, each from a layer of its own: splitting one wide output would
            # spend a quarter of a training step on gluing its gradient together.
            self.side = nn.ModuleList(nn.Linear(FILM_BOTTLENECK, width) for _ in range(2 * n_layers))

    def modulation(self, time: Tensor, context: Tensor) -> Modulation:
        """What the layers need to know of time (...,) and context (..., context_dim); each (..., width)."""
        features = time_features(time, self.n_frequencies).expand(*context.shape[:-1], -1)
        side = torch.cat([features, context], dim=-1)
        if self.conditioning == "film":
            side = self.bottleneck(side)
        return [layer(side) for layer in self.side]

    def forward(self, x: Tensor, modulation: Modulation) -> Tensor:
        """Velocity at the noisy chunk ``x`` (..., H * d), given :meth:`modulation`, broadcast against it."""
        hidden = self.input(x)
        if self.conditioning == "concat":
            hidden = functional.silu(hidden + modulation[0])
            for layer in self.hidden:
                hidden = functional.silu(layer(hidden))
            return self.output(hidden)
        for index in range(len(self.hidden) + 1):
            if index:
                hidden = self.hidden[index - 1](hidden)
            scale, shift = modulation[2 * index], modulation[2 * index + 1]
            hidden = functional.silu(torch.addcmul(hidden + shift, hidden, scale))
        return self.output(hidden)
