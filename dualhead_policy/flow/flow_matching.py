"""Conditional flow matching on linear interpolation paths (eq:cfm of the paper, sec:heads).

x_t = (1 - t) x_0 + t x_1, regression target x_1 - x_0, Euler integration from t = 0 to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import torch
from torch import Tensor

Generator = torch.Generator | None
#: Largest deviation of P^T P from the identity that counts as rounding.
ISOMETRY_TOLERANCE = 1e-5


def coupled_source_noise(
    shape: tuple[int, ...],
    dims: Mapping[str, int],
    beta: float,
    generator: Generator,
    private: Collection[str] = (),
    aligned: Mapping[str, Tensor] | None = None,
) -> dict[str, Tensor]:
    """Source noise of every head, coupled by ``beta`` (sec:heads).

    x_0^i = sqrt(1 - beta) s[:d_i] + sqrt(beta) eps_i with s and eps standard normal: beta = 1 is independent,
    beta = 0 fully shared. A narrower head takes the first coordinates of s at every step of the chunk, or P^T s where
    it is aligned by P; directions that P leaves out are its own. Every head's marginal is standard normal for any beta.

    Args:
        shape: Leading shape, for example (batch, H).
        dims: Dimensions of each head's space, by head.
        beta: Coupling in [0, 1].
        generator: Source of randomness; the draws are made on its device.
        private: Heads whose noise is their own whatever beta.
        aligned: Partial isometries P (d, d_i) of heads that take the first d coordinates of s through them, by head;
            see :mod:`dualhead_policy.flow.noise_alignment`.

    Returns:
        Noise by head, each (*shape, d_i).
    """
    device = generator.device if generator is not None else torch.device("cpu")

    def normal(width: int) -> Tensor:
        return torch.randn(*shape, width, generator=generator, device=device)

    if beta >= 1:
        return {head: normal(dim) for head, dim in dims.items()}
    shared = normal(max(dim for head, dim in dims.items() if head not in private))

    def drawn(head: str, dim: int) -> Tensor:
        if head in private:
            return normal(dim)
        common = shared[..., :dim]
        if aligned is not None and head in aligned:
            carry = aligned[head].to(shared)
            common = shared[..., : len(carry)] @ carry
            left_out = torch.eye(dim).to(carry) - carry.T @ carry
            if left_out.abs().max() > ISOMETRY_TOLERANCE:
                common = common + normal(dim) @ left_out
        if beta <= 0:
            return common
        return (1 - beta) ** 0.5 * common + beta**0.5 * normal(dim)

    return {head: drawn(head, dim) for head, dim in dims.items()}


def interpolate(source: Tensor, target: Tensor, time: Tensor) -> Tensor:
    """x_t = (1 - t) x_0 + t x_1 for chunks (B, ...) and times (B,)."""
    return torch.lerp(source, target, time.reshape(-1, *[1] * (source.ndim - 1)))


def integrate_euler(velocity: Callable[[Tensor, float], Tensor], source: Tensor, num_steps: int) -> Tensor:
    """Integrate dx/dt = velocity(x, t) from t = 0 to 1 in ``num_steps`` Euler steps (sec:gate uses 20)."""
    x = source
    for step in range(num_steps):
        x = x + velocity(x, step / num_steps) / num_steps
    return x


def integrate_within(
    velocity: Callable[[Tensor, float], Tensor], source: Tensor, num_steps: int, low: Tensor, high: Tensor
) -> tuple[Tensor, Tensor]:
    """Integrate as :func:`integrate_euler` does, the clean endpoint x + (1 - t) v of every step held to a range.

    A step moves x by the fraction dt / (1 - t) <= 1 of its way to that endpoint, so that x never leaves the hull of
    its source and the range, whatever the field.

    Args:
        velocity: The field, a function of x (..., d) and t in [0, 1).
        source: x_0 (..., d).
        num_steps: Number of steps.
        low, high: Smallest and largest clean endpoint (d,).

    Returns:
        x_1 (..., d), and whether an endpoint had to be held (...,).
    """
    x = source
    held = torch.zeros(source.shape[:-1], dtype=torch.bool, device=source.device)
    for step in range(num_steps):
        time = step / num_steps
        endpoint = torch.add(x, velocity(x, time), alpha=1 - time)
        inside = endpoint.clamp(low, high)
        held |= (inside != endpoint).any(dim=-1)
        x = torch.lerp(x, inside, 1 / (num_steps - step))
    return x, held
