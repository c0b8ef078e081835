"""Strict loading of ``model.safetensors``: nothing missing, nothing left over, nothing pickled."""

from __future__ import annotations

from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import nn


def load_strictly(model: nn.Module, model_file: str | Path, device: str) -> None:
    """Load every tensor of ``model_file`` into ``model``.

    Raises:
        FileNotFoundError: If the file is missing.
        ValueError: If the file is truncated or not safetensors, or its tensors are not exactly the model's.
    """
    path = Path(model_file)
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing: expected a checkpoint folder with model.safetensors")
    try:
        tensors = load_file(path, device=str(device))
    except SafetensorError as error:
        raise ValueError(
            f"{path} is not a readable safetensors file ({error}): it may be truncated; copy it again or load "
            "another checkpoint"
        ) from error
    own = model.state_dict()
    missing = sorted(set(own) - set(tensors))
    unexpected = sorted(set(tensors) - set(own))
    reshaped = sorted(name for name in set(own) & set(tensors) if own[name].shape != tensors[name].shape)
    for problem, names in (("lacks", missing), ("has unknown", unexpected), ("has misshapen", reshaped)):
        if names:
            shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
            raise ValueError(
                f"{path} {problem} tensors ({shown}): it does not belong to this config.json; load the folder "
                "that the policy was saved to"
            )
    model.load_state_dict(tensors, strict=True)
