"""Adam's step for N runs at once, with every run's own gradient clipping and learning rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

#: What torch.nn.utils.clip_grad_norm_ adds to a norm.
NORM_FLOOR = 1e-6


class StackedAdam:
    """The optimisers of N runs, whose moments become views of stacked ones; their options stay where they are.

    Args:
        parameters: Stacked parameters (N, ...) by name.
        optimizers: Each run's Adam, whose parameters are rows of ``parameters`` in the same order; their learning
            rates are read at every step, so that each run's own scheduler goes on setting them.
        max_norms: Largest gradient norm of every run.
    """

    def __init__(
        self,
        parameters: Mapping[str, Tensor],
        optimizers: Sequence[torch.optim.Optimizer],
        max_norms: Sequence[float],
    ):
        self._parameters = list(parameters.values())
        self._optimizers = optimizers
        self._max_norms = torch.tensor(max_norms, device=self._parameters[0].device)
        self._own = [optimizer.param_groups[0]["params"] for optimizer in optimizers]
        moments: list[list[Tensor]] = [[], []]
        for index, parameter in enumerate(self._parameters):
            for name, stacks in zip(("exp_avg", "exp_avg_sq"), moments, strict=True):
                rows = [self._state(run, index).get(name) for run in range(len(optimizers))]
                stacked = torch.stack([torch.zeros_like(parameter[0]) if row is None else row for row in rows])
                stacks.append(stacked)
                for run, row in enumerate(stacked):
                    self._state(run, index)[name] = row
        self._first, self._second = moments
        made = self._state(0, 0).get("step", torch.zeros(()))
        self._count = made.detach().clone().to(self._parameters[0].device, torch.float32)
        for optimizer in optimizers:
            # This step stands for theirs: their schedulers must not complain that none was made.
            optimizer._opt_called = True  # type: ignore[attr-defined]

    def _state(self, run: int, index: int) -> dict[str, Tensor]:
        return self._optimizers[run].state[self._own[run][index]]

    @torch.no_grad()
    def step(self, gradients: Sequence[Tensor]) -> None:
        """One step down the stacked gradients (N, ...), which may be clipped in place."""
        # The fused kernel walks through memory and does not look at strides.
        gradients = [gradient.contiguous() for gradient in gradients]
        share = self._share(gradients)
        if bool((share < 1).any()):
            _scale(gradients, share)
        rates: list[float | Tensor] = [optimizer.param_groups[0]["lr"] for optimizer in self._optimizers]
        self._adam(gradients, rates, together=len(set(rates)) == 1)

    @torch.no_grad()
    def device_step(self, gradients: Sequence[Tensor], rates: Tensor, *, together: bool) -> None:
        """The same step with learning rates (N,) on the device, where nothing waits for the host.

        Args:
            gradients: As for :meth:`step`.
            rates: Learning rates.
            together: Whether they are all one, at every step.
        """
        gradients = [gradient.contiguous() for gradient in gradients]
        _scale(gradients, self._share(gradients))
        self._adam(gradients, list(rates.unbind()), together=together)

    def _adam(self, gradients: Sequence[Tensor], rates: Sequence[float | Tensor], *, together: bool) -> None:
        stacks: list[Sequence[Tensor]] = [self._parameters, gradients, self._first, self._second]
        self._count += 1
        if together:
            self._fused(stacks, rates[0])
        else:
            for run, rate in enumerate(rates):
                self._fused([[tensor[run] for tensor in stack] for stack in stacks], rate)

    def _fused(self, stacks: Sequence[Sequence[Tensor]], rate: float | Tensor) -> None:
        parameters, gradients, first, second = (list(stack) for stack in stacks)
        options = self._optimizers[0].param_groups[0]
        torch._fused_adam_(
            parameters,
            gradients,
            first,
            second,
            [],
            [self._count] * len(parameters),
            lr=rate,
            beta1=options["betas"][0],
            beta2=options["betas"][1],
            weight_decay=options["weight_decay"],
            eps=options["eps"],
            amsgrad=False,
            maximize=False,
        )

    def _share(self, gradients: Sequence[Tensor]) -> Tensor:
        """What clipping leaves of every run's gradient (N,)."""
        norms = torch.stack([torch.linalg.vector_norm(gradient.flatten(1), dim=1) for gradient in gradients])
        return (self._max_norms / (torch.linalg.vector_norm(norms, dim=0) + NORM_FLOOR)).clamp(max=1)

    def write_counts(self) -> None:
        """Tell every optimiser how many steps it has made, before its state is saved."""
        for run in range(len(self._optimizers)):
            for index in range(len(self._parameters)):
                self._state(run, index)["step"] = self._count.clone()


def _scale(gradients: Sequence[Tensor], share: Tensor) -> None:
    for gradient in gradients:
        gradient.mul_(share.reshape(-1, *[1] * (gradient.ndim - 1)))
