"""Source noise that the heads share through the kinematic map, instead of coordinate by coordinate.

Heads that share a vector of source noise coordinate as far as their noise-to-mode maps are aligned. For two equally
likely modes whose paths differ by D_i in head i's coordinates, head i decides by the sign of <x_0^i, D_i>, and

    rho = (2 / pi) asin(a),   a = <P^T D_1, D_2> / (|D_1| |D_2|),

where head 2 takes P^T x_0^1 as its noise (docs/noise_alignment.md). A narrower head that takes the first coordinates
of one vector, as in sec:heads, lines up coordinates that have nothing to do with each other: on a robot a is near zero,
and its sign an accident. What the two heads have in common is known, though: the kinematic map. With the residual
covariance S of the joint head's chunks and the map's Jacobian G, both in the heads' normalised units, the
cross-covariance of the two representations is S G^T at every step of the chunk, and the P that maximises
tr(P^T sum_h S_hh G^T) among isometries (orthogonal Procrustes) is its polar factor. It needs neither labels nor modes
nor data: S is in the policy's frames. A policy without frames knows the spread of every coordinate alone; there S G^T
is taken to be pinv(G) times the position's variances, as if the joints moved no more than the hand asks for.
Every head's noise stays standard normal, so that what each head samples is unchanged.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from dualhead_policy.kinematics.rotation6d import columns_from_matrix
from dualhead_policy.model.dualhead_model import DualheadModel

#: Singular values below this share of the largest count as none: directions that the map does not move.
RANK_TOLERANCE = 1e-5
#: Alignments of models in use and the versions of the scales that they come from: a training asks at every step.
_known: WeakKeyDictionary[DualheadModel, tuple[tuple[int, ...], dict[str, Tensor]]] = WeakKeyDictionary()


def polar_factor(cross_covariance: Tensor) -> Tensor:
    """The partial isometry P (d_1, d_2) nearest a cross-covariance (d_1, d_2), in float64.

    P^T P is the identity but on directions that the cross-covariance does not reach, where P is zero.

    Raises:
        ValueError: If a number is not finite, or all are zero.
    """
    if not torch.isfinite(cross_covariance).all() or not cross_covariance.any():
        raise ValueError(
            "the kinematic map's derivative at the mean action is zero or not finite, expected a map that is smooth "
            "there: share the noise coordinate by coordinate instead"
        )
    left, values, right = torch.linalg.svd(cross_covariance.double(), full_matrices=False)
    kept = values > RANK_TOLERANCE * values.max()
    return left[:, kept] @ right[kept]


def own_alignment(model: DualheadModel) -> dict[str, Tensor] | None:
    """:func:`kinematic_alignment` where the model's configuration asks for it, else None."""
    return None if model.config.source_noise_alignment is None else kinematic_alignment(model)


def kinematic_alignment(model: DualheadModel) -> dict[str, Tensor]:
    """What carries the joint head's source noise to every other head: matrices (d_joint, d) by head, float32.

    Args:
        model: A model with fitted scales; its kinematic map is linearised at the mean action.

    Raises:
        ValueError: If the map cannot be linearised there.
    """
    fitted = [model.action_scale.scale, model.action_scale.shift, model.action_scale.spread]
    if "joint" in model.frames:
        fitted += [model.frame("joint").basis, model.frame("joint").spread]
    versions = tuple(buffer._version for buffer in fitted)
    known = _known.get(model)
    if known is None or known[0] != versions:
        # LeRobot samples in inference mode, in which nothing can be differentiated.
        with torch.inference_mode(False), torch.no_grad():
            known = _known[model] = versions, _linearised(model)
    return known[1]


def _linearised(model: DualheadModel) -> dict[str, Tensor]:
    scale, shift = (value.double().cpu() for value in (model.action_scale.scale, model.action_scale.shift))
    joint = model.head_slices["joint"]
    aligned = {}
    for head, part in model.head_slices.items():
        if head == "joint":
            continue

        def forward(values: Tensor, head: str = head) -> Tensor:
            if head == "rotation":
                return columns_from_matrix(model.kinematics.rotation(values))
            return model.kinematics.position(values)

        with torch.enable_grad():
            jacobian = torch.autograd.functional.jacobian(forward, shift[joint])
        jacobian = jacobian * scale[joint] / scale[part, None]
        aligned[head] = polar_factor(_cross_covariance(model, head, jacobian)).float()
    return aligned


def _cross_covariance(model: DualheadModel, head: str, jacobian: Tensor) -> Tensor:
    """Of the joint head's normalised chunks and another's, (d_joint, d), summed over their steps, float64."""
    if not torch.isfinite(jacobian).all():
        return jacobian.T
    if "joint" not in model.frames:
        spread = model.action_scale.spread[model.head_slices[head]].double().cpu()
        return torch.linalg.pinv(jacobian, rtol=RANK_TOLERANCE) * spread.square()
    frame, dim = model.frame("joint"), model.head_dims["joint"]
    basis, spread = frame.basis.double().cpu(), frame.spread.double().cpu()
    covariance = (basis * spread.square()) @ basis.T
    horizon = len(covariance) // dim
    return torch.einsum("hihj->ij", covariance.reshape(horizon, dim, horizon, dim)) @ jacobian.T
