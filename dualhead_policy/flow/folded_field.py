"""A head's velocity field folded for sampling: all that does not depend on the noisy chunk, computed once.

Sampling visits few contexts (a condition, or a condition and a token) at few times, with many chunks each, or with one
where a robot waits for it. What time and context contribute to every layer is therefore computed for all of them
together, the biases with it, and the preconditioning is folded into the clean endpoint:

    a = x + (1 - t) v = keep * x + give * F(scale_in * x),   keep = 1 + (1 - t) skip,   give = (1 - t) scale_out.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from dualhead_policy.model.dualhead_model import DualheadModel
from dualhead_policy.model.network import gaussian_preconditioning


class FoldedField:
    """The clean endpoints of one head at S times under C contexts.

    Args:
        model: The model.
        head: Name of the head.
        time: Flow times (S,) in [0, 1).
        context: Contexts (C, E), as :meth:`DualheadModel.context` gives them.
    """

    def __init__(self, model: DualheadModel, head: str, time: Tensor, context: Tensor):
        field = model.network.field(head)
        left = (1 - time)[:, None, None]
        modulation = field.modulation(time[:, None], context.expand(len(time), *context.shape))
        self._layers, self._output = [field.input, *field.hidden], field.output
        # Unbound over time: indexing a tensor costs as much as a layer does where a robot waits for one chunk.
        self._gain: list[tuple[Tensor, ...]] = []
        if field.conditioning == "film":
            gains = [1 + scale for scale in modulation[::2]]
            shifts = [
                shift + gain * layer.bias
                for shift, gain, layer in zip(modulation[1::2], gains, self._layers, strict=True)
            ]
            self._gain = [gain.unbind() for gain in gains]
        else:
            shifts = [modulation[0] + field.input.bias]
        self._shift = [shift.unbind() for shift in shifts]
        self._scale_in: tuple[Tensor, ...] | None = None
        self._keep: tuple[Tensor, ...] | None = None
        give = left
        if model.network.preconditioned:
            skip, scale_out, scale_in = gaussian_preconditioning(time[:, None, None], model.spread(head))
            self._scale_in, self._keep, give = scale_in.unbind(), (1 + left * skip).unbind(), left * scale_out
        self._give = give.unbind()

    def endpoint(self, step: int, x: Tensor, index: Tensor | None = None) -> Tensor:
        """Clean endpoints (R, H * d) of noisy chunks ``x`` (R, H * d) at time ``step``.

        Args:
            step: Index of the time.
            x: Noisy chunks, in the head's frame.
            index: The context of every chunk (R,); None where there is one context, or one for every chunk.
        """
        hidden = x if self._scale_in is None else x * self._scale_in[step]
        for layer, linear in enumerate(self._layers):
            if layer >= len(self._shift):
                hidden = functional.silu(linear(hidden), inplace=True)
                continue
            shift = self._shift[layer][step]
            shift = shift if index is None else shift[index]
            hidden = functional.linear(hidden, linear.weight)
            if self._gain:
                gain = self._gain[layer][step]
                hidden = torch.addcmul(shift, hidden, gain if index is None else gain[index])
            else:
                hidden = hidden + shift
            hidden = functional.silu(hidden, inplace=True)
        moved = self._output(hidden)
        return torch.addcmul(x if self._keep is None else x * self._keep[step], moved, self._give[step])
