"""What shared source noise does to two heads, said by the demonstrations before anything is sampled.

The law is that of :mod:`dualhead_policy.flow.noise_alignment`: rho = (2 / pi) asin(a) for two equally likely modes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from dualhead_envs.dataset_frames import SplitFrames
    from dualhead_policy.model.dualhead_model import DualheadModel


def rho_of_alignment(alignment: ArrayLike) -> NDArray[np.float64]:
    """rho (...) of two equally likely modes whose deciding projections have the correlation ``alignment`` (...)."""
    return 2 / np.pi * np.arcsin(np.clip(np.asarray(alignment, dtype=np.float64), -1, 1))


def demonstrated_alignment(
    model: DualheadModel,
    frames: SplitFrames,
    heads: tuple[str, str] = ("joint", "position"),
    source_noise_alignment: str | None = None,
) -> NDArray[np.float64]:
    """The correlation a (pairs,) of two heads' deciding projections under fully shared source noise.

    Args:
        model: A model with fitted scales, trained or not.
        frames: Demonstrations of every pair in two modes, on whose paths after the branch a is computed.
        heads: The two heads.
        source_noise_alignment: As in :class:`dualhead_policy.sampling.SamplingCoupling`.

    Raises:
        ValueError: If the model lacks a head, or the demonstrations are not pairs in two modes.
    """
    from dualhead_policy.flow.noise_alignment import kinematic_alignment  # not for the law alone: it loads torch

    if unknown := sorted(set(heads) - set(model.head_slices)):
        raise ValueError(f"the policy has no head {unknown[0]!r}: choose two of {list(model.head_slices)}")
    scale = model.action_scale.scale.double().cpu().numpy()
    apart = []
    for head in heads:
        windows = frames.mode_windows(model.config.chunk_size, f"{head}.")
        if windows is None or windows.shape[1] != 2:
            raise ValueError(
                f"{frames.root} does not show every pair in two modes with whole windows, expected a recording of "
                "`dualhead record` with two modes: give another split"
            )
        apart.append((windows[:, 0] - windows[:, 1]) / scale[model.head_slices[head]])
    carried = {} if source_noise_alignment is None else kinematic_alignment(model)
    # What the shared noise's coordinates see of a difference of paths.
    seen = [
        path @ carried[head].double().numpy().T if head in carried else path
        for path, head in zip(apart, heads, strict=True)
    ]
    width = min(path.shape[-1] for path in seen)
    overlap = np.einsum("bhd,bhd->b", *(path[..., :width] for path in seen))
    return overlap / np.prod([np.linalg.norm(path, axis=(1, 2)) for path in apart], axis=0)
