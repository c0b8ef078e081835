"""Open a policy of one of LeRobot's other types, quietly, strictly, and without running anything of its folder."""

from __future__ import annotations

import contextlib
import io
import warnings
from pathlib import Path

import torch
from lerobot.policies import get_policy_class
from safetensors import SafetensorError, safe_open

from dualhead_policy.checkpoint_loading import load_strictly
from dualhead_policy.hub_folder import file_inside
from dualhead_policy.lerobot_policies.chunks import ChunkPolicy
from dualhead_policy.lerobot_policies.configuration_loading import REMEDY, read_lerobot_configuration
from dualhead_policy.lerobot_policies.step_loading import load_steps

WEIGHTS = "model.safetensors"


def open_lerobot_policy(folder: Path, *, device: str = "cpu") -> ChunkPolicy:
    """A policy with its processors.

    Args:
        folder: A policy's folder, see :func:`dualhead_policy.pretrained.policy_folder`.
        device: Where the policy runs.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If the type is not one that is opened, or configuration, weights and processors do not belong
            together.
        ImportError: If the type needs a package that is not installed.
    """
    config, policy_type = read_lerobot_configuration(folder, device=device)
    policy_class = get_policy_class(config.type)
    weights = file_inside(folder, WEIGHTS)
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _check_shapes(policy_class, config, weights)
        try:
            policy = policy_class(config)
        except ValueError as error:
            raise ValueError(f"{folder / 'config.json'} makes no policy ({error}): {REMEDY}") from error
        load_strictly(policy, weights, device)
        processors = load_steps(folder, config)
    policy.to(device).eval()
    return ChunkPolicy(policy, *processors, policy_type)


def _check_shapes(policy_class: type, config: object, weights: Path) -> None:
    """Refuse a configuration of another network than the weights', before anything of its size is allocated."""
    try:
        with safe_open(weights, "pt") as file:
            held = {name: file.get_slice(name).get_shape() for name in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise ValueError(f"{weights} is not a readable safetensors file: it may be truncated; {REMEDY}") from error
    try:
        with torch.device("meta"):
            expected = {name: list(tensor.shape) for name, tensor in policy_class(config).state_dict().items()}
    except (ValueError, TypeError, RuntimeError, AssertionError) as error:
        raise ValueError(f"{weights.parent / 'config.json'} makes no policy ({error}): {REMEDY}") from error
    if held != expected:
        different = sorted(name for name in held.keys() | expected.keys() if held.get(name) != expected.get(name))
        raise ValueError(
            f"{weights} holds other tensors than config.json describes ({len(different)}, the first "
            f"{different[0]!a:.80}: {held.get(different[0])} instead of {expected.get(different[0])}): {REMEDY}"
        )
