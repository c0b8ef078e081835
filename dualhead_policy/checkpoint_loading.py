"""Strict loading of ``model.safetensors``: nothing missing, nothing left over, nothing pickled."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import nn

from dualhead_envs.validated_json import shown
from dualhead_policy.hub_folder import file_inside


def load_strictly(model: nn.Module, model_file: str | Path) -> None:
    """Load every tensor of ``model_file`` into ``model``; one that has several names there is held under any of them.

    The file is read and checked on the CPU, whichever device the model is on.

    Raises:
        FileNotFoundError: If the file is missing.
        ValueError: If the file is truncated, not safetensors or a link out of its folder, or its tensors are not
            exactly the model's, or not finite.
    """
    path = file_inside(Path(model_file).parent, Path(model_file).name)
    try:
        tensors = load_file(path)
    except SafetensorError as error:
        raise ValueError(
            f"{path} is not a readable safetensors file: it may be truncated; copy it again or load another checkpoint"
        ) from error
    own = {name: value.cpu() for name, value in model.state_dict().items()}
    missing = sorted(missing_tensors(model, tensors))
    unexpected = sorted(set(tensors) - set(own))
    reshaped = sorted(
        name
        for name in set(own) & set(tensors)
        if own[name].shape != tensors[name].shape or own[name].is_floating_point() != tensors[name].is_floating_point()
    )
    # The range of observations is unbounded in a policy that was never fitted.
    infinite = sorted(
        name
        for name in set(own) & set(tensors) - set(reshaped)
        if not (torch.isfinite(tensors[name]) | (tensors[name] == own[name])).all()
    )
    problems = {"lacks": missing, "has unknown": unexpected, "has misshapen": reshaped, "has non-finite": infinite}
    for problem, names in problems.items():
        if names:
            some = ", ".join(shown(name) for name in names[:3]) + (f" and {len(names) - 3} more" if names[3:] else "")
            raise ValueError(
                f"{path} {problem} tensors ({some}): it does not belong to this config.json; load the folder "
                "that the policy was saved to"
            )
    model.load_state_dict(tensors, strict=False)


def missing_tensors(model: nn.Module, held: Collection[str]) -> set[str]:
    """Names of the tensors of ``model`` that are held under none of their names.

    Args:
        model: The model; modules that it holds twice give their tensors two names, of which files keep one.
        held: Names in a file.
    """
    own = model.state_dict(keep_vars=True)
    covered = {id(own[name]) for name in own.keys() & set(held)}
    return {name for name, tensor in own.items() if id(tensor) not in covered}
