"""The velocity field of many runs at once, forward and backward, as batched matrix products.

Nine tenths of a training step's arithmetic is in the heads' velocity fields. Under ``torch.vmap`` their layers become
a product, a sum and a chain of elementwise operations each, forward and backward, and every one of them is another
pass over the activations. Here the derivative is written down: biases enter with the products (``torch.baddbmm``), the
FiLM scale is kept as 1 + scale, and a layer costs two elementwise passes forward and three backward.

:class:`StackableField` stands in for a model's field; under ``vmap`` over runs it reaches :class:`StackedField` with
the tensors of all runs stacked, so that the training loss is written once, for one run.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional

from dualhead_policy.model.velocity_field import Modulation, VelocityField, time_features

#: Types in which the fields compute, by name.
PRECISIONS = {"fp32": torch.float32, "tf32": torch.float32, "bf16": torch.bfloat16}
Precision = Literal["fp32", "tf32", "bf16"]


@contextmanager
def _tensor_cores(precision: Precision) -> Iterator[None]:
    """CUDA's products of float32 from factors rounded to ten bits, for the fields alone.

    A chunk frame's rotations need all bits: its smallest coordinates are a thousandth of its largest.
    """
    before = torch.backends.cuda.matmul.allow_tf32
    torch.backends.cuda.matmul.allow_tf32 = before or precision == "tf32"
    try:
        yield
    finally:
        torch.backends.cuda.matmul.allow_tf32 = before


class StackableField(nn.Module):
    """A velocity field that ``torch.vmap`` over runs computes by :class:`StackedField`; the wrapped one's parameters.

    Args:
        field: The field.
        precision: Type of activations and products; parameters and their gradients stay in float32.
    """

    def __init__(self, field: VelocityField, precision: Precision):
        super().__init__()
        self.precision = precision
        self.n_frequencies, self.conditioning = field.n_frequencies, field.conditioning
        self.input, self.hidden, self.output, self.side = field.input, field.hidden, field.output, field.side
        self.bottleneck = field.bottleneck if field.conditioning == "film" else None

    def modulation(self, time: Tensor, context: Tensor) -> Modulation:
        """What enters every layer's modulation (B, S): the FiLM bottleneck's output, or time features and context."""
        features = time_features(time, self.n_frequencies).expand(*context.shape[:-1], -1)
        side = torch.cat([features, context], dim=-1)
        return [side if self.bottleneck is None else self.bottleneck(side)]

    def forward(self, x: Tensor, modulation: Modulation) -> Tensor:
        """Velocity (B, H * d) at the noisy chunk ``x`` (B, H * d)."""
        layers = [self.input, *self.hidden, self.output]
        layers_and_side = (*layers, *self.side)
        parameters = [value for layer in layers_and_side for value in layer._parameters.values() if value is not None]
        return _UnderVmap.apply(self.precision, len(layers), x, modulation[0], *parameters)


class _UnderVmap(torch.autograd.Function):
    """One run's field as ``torch.vmap`` sees it: it is never computed alone."""

    @staticmethod
    def forward(precision: Precision, n_layers: int, *tensors: Tensor) -> Tensor:
        stacked = StackedField.apply(precision, n_layers, *(tensor[None] for tensor in tensors))
        return stacked[0]

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        raise NotImplementedError("a StackableField is differentiated under torch.vmap only")

    @staticmethod
    def vmap(info: Any, in_dims: Any, precision: Precision, n_layers: int, *tensors: Tensor) -> Any:
        stacked = (
            tensor.expand(info.batch_size, *tensor.shape) if dim is None else tensor.movedim(dim, 0)
            for tensor, dim in zip(tensors, in_dims[2:], strict=True)
        )
        return StackedField.apply(precision, n_layers, *stacked), 0


class StackedField(torch.autograd.Function):
    """v(x, side) of N stacked fields; see the module.

    Args:
        precision: Type of activations and products.
        n_layers: Linear layers from x to the velocity: input, hidden ones, output.
        x: Noisy chunks (N, B, D), to which no gradient is sent.
        side: FiLM bottleneck's output, or time features and context, (N, B, S).
        parameters: Weight (N, out, in) and bias (N, out) of each of those layers; then, with FiLM, weight and bias of
            scale and shift of every layer but the last, or, with concatenation, the side's one weight.
    """

    @staticmethod
    def forward(ctx: Any, precision: Precision, n_layers: int, x: Tensor, side: Tensor, *parameters: Tensor) -> Tensor:
        ctx.precision = precision
        with _tensor_cores(precision):
            return StackedField._forward(ctx, PRECISIONS[precision], n_layers, x, side, *parameters)

    @staticmethod
    def _forward(
        ctx: Any, compute_dtype: torch.dtype, n_layers: int, x: Tensor, side: Tensor, *parameters: Tensor
    ) -> Tensor:
        dtype = x.dtype
        side = side.to(compute_dtype)
        weights = [parameter.to(compute_dtype) for parameter in parameters]
        ctx.n_layers, ctx.film, ctx.dtype = n_layers, len(weights) > 2 * n_layers + 1, dtype
        hidden, kept = x.to(compute_dtype), [side]
        for layer in range(n_layers - 1):
            product = _affine(hidden, weights[2 * layer], weights[2 * layer + 1])
            kept.append(hidden)
            if ctx.film:
                scale_weight, scale_bias, shift_weight, shift_bias = weights[2 * n_layers + 4 * layer :][:4]
                gain = _affine(side, scale_weight, scale_bias + 1)
                activation = _affine(side, shift_weight, shift_bias).addcmul_(product, gain)
                kept += [product, gain]
            else:
                activation = product
                if layer == 0:
                    activation.baddbmm_(side, weights[2 * n_layers].transpose(1, 2))
            kept.append(activation)
            hidden = functional.silu(activation)
        ctx.save_for_backward(hidden, *kept, *weights)
        return _affine(hidden, weights[2 * n_layers - 2], weights[2 * n_layers - 1]).to(dtype)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, velocity_gradient: Tensor) -> Any:
        with _tensor_cores(ctx.precision):
            return StackedField._backward(ctx, velocity_gradient)

    @staticmethod
    def _backward(ctx: Any, velocity_gradient: Tensor) -> Any:
        n_layers, film, dtype = ctx.n_layers, ctx.film, ctx.dtype
        if ctx.needs_input_grad[2]:
            raise NotImplementedError("StackedField sends no gradient to the noisy chunk")
        hidden, side, *rest = ctx.saved_tensors
        n_kept = (4 if film else 2) * (n_layers - 1)
        kept, weights = rest[:n_kept], rest[n_kept:]
        gradients: list[Tensor | None] = [None] * len(weights)
        velocity_gradient = velocity_gradient.to(side.dtype)
        gradients[2 * n_layers - 2] = _product_gradient(velocity_gradient, hidden, dtype)
        gradients[2 * n_layers - 1] = _bias_gradient(velocity_gradient, dtype)
        gradient = torch.bmm(velocity_gradient, weights[2 * n_layers - 2])
        side_gradient: Tensor | None = None
        for layer in reversed(range(n_layers - 1)):
            if film:
                below, product, gain, activation = kept[4 * layer : 4 * layer + 4]
            else:
                below, activation = kept[2 * layer : 2 * layer + 2]
            shift = torch.ops.aten.silu_backward(gradient, activation)
            if film:
                at = 2 * n_layers + 4 * layer
                scale = shift * product
                for offset, part in ((0, scale), (2, shift)):
                    gradients[at + offset] = _product_gradient(part, side, dtype)
                    gradients[at + offset + 1] = _bias_gradient(part, dtype)
                    if side_gradient is None:
                        side_gradient = torch.bmm(part, weights[at + offset])
                    else:
                        side_gradient.baddbmm_(part, weights[at + offset])
                gradient = torch.mul(shift, gain, out=scale)
            else:
                gradient = shift
                if layer == 0:
                    gradients[2 * n_layers] = _product_gradient(shift, side, dtype)
                    side_gradient = torch.bmm(shift, weights[2 * n_layers])
            gradients[2 * layer] = _product_gradient(gradient, below, dtype)
            gradients[2 * layer + 1] = _bias_gradient(gradient, dtype)
            if layer:
                gradient = torch.bmm(gradient, weights[2 * layer])
        assert side_gradient is not None
        return None, None, None, side_gradient.to(dtype), *gradients


def _affine(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """x W^T + b of every run: (N, B, in), (N, out, in), (N, out) -> (N, B, out)."""
    return torch.baddbmm(bias[:, None], x, weight.transpose(1, 2))


def _product_gradient(gradient: Tensor, x: Tensor, dtype: torch.dtype) -> Tensor:
    """Gradient (N, out, in) of a layer's weight, given those of its output (N, B, out) and its input (N, B, in)."""
    return torch.bmm(gradient.transpose(1, 2), x).to(dtype)


def _bias_gradient(gradient: Tensor, dtype: torch.dtype) -> Tensor:
    return gradient.sum(dim=1, dtype=dtype)
