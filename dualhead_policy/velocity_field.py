"""The condition encoder and a head's velocity field.

A velocity field is evaluated in two parts, so that sampling many chunks for one condition pays for the
conditioning once: :meth:`VelocityField.modulation` turns (time, condition, token) into what each layer needs,
and :meth:`VelocityField.forward` applies it to the noisy chunk.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

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
    """E(c): observation (..., C) -> embedding (..., width), two layers, shared by the heads (sec:heads)."""

    def __init__(self, observation_dim: int, width: int):
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(observation_dim, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU())

    def forward(self, observation: Tensor) -> Tensor:
        return self.layers(observation)


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
        self.side: nn.Module
        if conditioning == "concat":
            # W [x, t, context] = W_x x + W_s [t, context]: the second product is shared by all samples of a
            # condition. Both halves start as one dense layer of the concatenated input would.
            side = nn.Linear(side_dim, width, bias=False)
            bound = (chunk_dim + side_dim) ** -0.5
            for parameter in (self.input.weight, self.input.bias, side.weight):
                nn.init.uniform_(parameter, -bound, bound)
            self.side = side
        else:
            self.side = nn.Sequential(
                nn.Linear(side_dim, FILM_BOTTLENECK),
                nn.SiLU(),
                nn.Linear(FILM_BOTTLENECK, 2 * width * n_layers),
            )

    def modulation(self, time: Tensor, context: Tensor) -> Tensor:
        """What the layers need to know of time (...,) and context (..., context_dim); shape (..., M)."""
        features = time_features(time, self.n_frequencies).expand(*context.shape[:-1], -1)
        return self.side(torch.cat([features, context], dim=-1))

    def forward(self, x: Tensor, modulation: Tensor) -> Tensor:
        """Velocity at the noisy chunk ``x`` (..., H * d), given :meth:`modulation` of matching shape."""
        hidden = self.input(x)
        if self.conditioning == "concat":
            hidden = functional.silu(hidden + modulation)
            for layer in self.hidden:
                hidden = functional.silu(layer(hidden))
            return self.output(hidden)
        width = hidden.shape[-1]
        per_layer = modulation.split(2 * width, dim=-1)
        for index, film in enumerate(per_layer):
            if index:
                hidden = self.hidden[index - 1](hidden)
            scale, shift = film.split(width, dim=-1)
            hidden = functional.silu(torch.addcmul(hidden + shift, hidden, scale))
        return self.output(hidden)
