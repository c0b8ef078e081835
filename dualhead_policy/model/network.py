"""The network: one condition encoder, one velocity field per head, nothing shared between the heads' fields."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import torch
from torch import Tensor, nn

from dualhead_policy.model.velocity_field import ConditionEncoder, Modulation, VelocityField


def gaussian_preconditioning(time: Tensor, spread: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Coefficients (skip, output scale, input scale) of a preconditioned velocity field.

    If a coordinate of the data were N(0, sigma^2), the population-optimal velocity at x_t would be the linear
    function skip * x_t with skip = (t sigma^2 - (1 - t)) / S, S = (1 - t)^2 + t^2 sigma^2, and the regression
    target would keep the standard deviation sigma / sqrt(S) around it. The network learns the remainder, at
    unit scale, from x_t / sqrt(S), which has unit scale too (as Karras et al. 2022 do for diffusion). The loss
    and its minimiser are unchanged. At sigma = 0 the linear part, -x_t / (1 - t), is exact.

    Args:
        time: Flow time, shape broadcastable against ``spread``, below 1.
        spread: sigma per coordinate.
    """
    variance = (1 - time).square() + (time * spread).square()
    deviation = variance.sqrt()
    return (time * spread.square() - (1 - time)) / variance, spread / deviation, 1 / deviation


class DualheadNetwork(nn.Module):
    """Encoder E(c) and the heads' velocity fields.

    Args:
        observation_dim: Size of the concatenated observation.
        head_dims: Dimensions of each head's space, by head.
        chunk_size: H.
        token_dim: Size of the token's one-hot code, 0 without tokens.
        width, n_layers, n_frequencies, encoder_dim, conditioning: See ``DualheadConfig``.
        preconditioned: Whether :func:`gaussian_preconditioning` is used.
        embedding_gain: Factor on E(c).
    """

    def __init__(
        self,
        observation_dim: int,
        head_dims: Mapping[str, int],
        *,
        chunk_size: int,
        token_dim: int,
        encoder_dim: int,
        width: int,
        n_layers: int,
        n_frequencies: int,
        conditioning: str,
        preconditioned: bool,
        embedding_gain: float,
    ):
        super().__init__()
        self.preconditioned = preconditioned
        self.encoder = ConditionEncoder(observation_dim, encoder_dim, embedding_gain)
        self.fields = nn.ModuleDict(
            {
                head: VelocityField(
                    chunk_size * dim,
                    encoder_dim + token_dim,
                    width=width,
                    n_layers=n_layers,
                    n_frequencies=n_frequencies,
                    conditioning=conditioning,
                )
                for head, dim in head_dims.items()
            }
        )

    def modulation(self, head: str, time: Tensor, context: Tensor) -> Modulation:
        """What ``head``'s layers need to know of time and context; see :class:`VelocityField`."""
        return self.field(head).modulation(time, context)

    def field(self, head: str) -> VelocityField:
        """The velocity field of ``head``."""
        return cast(VelocityField, self.fields[head])

    def velocity(self, head: str, x: Tensor, time: Tensor, modulation: Modulation, spread: Tensor) -> Tensor:
        """v_head(x_t, t, context) for flattened chunks.

        Args:
            head: Name of the head.
            x: Noisy chunks (..., H * d).
            time: Flow time, shape (..., 1) or scalar.
            modulation: :meth:`modulation`, broadcastable against ``x``.
            spread: Scale of the normalised data per coordinate (H * d,).
        """
        field = self.field(head)
        if not self.preconditioned:
            return field(x, modulation)
        skip, scale_out, scale_in = gaussian_preconditioning(time, spread)
        return torch.addcmul(skip * x, scale_out, field(scale_in * x, modulation))
