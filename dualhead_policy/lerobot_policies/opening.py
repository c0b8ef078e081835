"""Open a policy of any type that LeRobot knows, quietly, strictly, and without running anything of its folder."""

from __future__ import annotations

import contextlib
import io
import warnings
from pathlib import Path

import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies import get_policy_class
from safetensors import SafetensorError, safe_open

from dualhead_policy.checkpoint_loading import load_strictly, missing_tensors
from dualhead_policy.hub_folder import file_inside
from dualhead_policy.lerobot_policies.chunks import ChunkPolicy
from dualhead_policy.lerobot_policies.configuration_loading import REMEDY, read_lerobot_configuration, read_policy_type
from dualhead_policy.lerobot_policies.offline import FetchError, offline
from dualhead_policy.lerobot_policies.step_loading import load_steps

WEIGHTS = "model.safetensors"


def open_lerobot_policy(folder: Path, *, device: str = "cpu") -> ChunkPolicy:
    """A policy with its processors.

    Nothing of the folder is run, and nothing is fetched meanwhile.

    Args:
        folder: A policy's folder, see :func:`dualhead_policy.pretrained.policy_folder`.
        device: Where the policy runs.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If nothing installed registers the type, it lacks a package or would fetch anything, or
            configuration, weights and processors do not belong together.
    """
    source = folder / "config.json"
    with offline() as attempts, contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return _open(folder, device)
        except ImportError as error:
            raise ValueError(
                f"{source} is of type {read_policy_type(folder)!r}, which lacks a package here ({error}): install it "
                "and try again"
            ) from error
        except Exception as error:
            if not attempts:
                raise
            raise ValueError(
                f"{source} is of type {read_policy_type(folder)!r}, which fetches files from {attempts[0]!a:.80} when "
                "it is opened, expected a policy that is whole in its folder: load it yourself and evaluate it in "
                "Python (docs/any_policy.md)"
            ) from error


def _open(folder: Path, device: str) -> ChunkPolicy:
    config, policy_type = read_lerobot_configuration(folder, device=device)
    policy_class = get_policy_class(config.type)
    weights = file_inside(folder, WEIGHTS)
    _check_shapes(policy_class, config, weights)
    policy = _made(policy_class, config, folder)
    load_strictly(policy, weights)
    processors = load_steps(folder, config)
    policy.to(device).eval()
    return ChunkPolicy(policy, *processors, policy_type)


def _made(policy_class: type, config: PreTrainedConfig, folder: Path) -> torch.nn.Module:
    """A policy of this configuration, not yet with its weights."""
    try:
        return policy_class(config)
    except (ImportError, FetchError):
        raise
    except Exception as error:  # a type raises what it likes; all of it is about the configuration
        raise ValueError(f"{folder / 'config.json'} makes no policy ({_shown(error)}): {REMEDY}") from error


def _shown(error: Exception) -> str:
    """An error as part of a sentence."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def _check_shapes(policy_class: type, config: PreTrainedConfig, weights: Path) -> None:
    """Refuse a configuration of another network than the weights', before anything of its size is allocated."""
    try:
        with safe_open(weights, "pt") as file:
            held = {name: file.get_slice(name).get_shape() for name in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise ValueError(f"{weights} is not a readable safetensors file: it may be truncated; {REMEDY}") from error
    with torch.device("meta"):
        policy = _made(policy_class, config, weights.parent)
    own = {name: list(tensor.shape) for name, tensor in policy.state_dict().items()}
    missing = missing_tensors(policy, held)
    different = sorted(missing | {name for name, shape in held.items() if own.get(name) != shape})
    if different:
        raise ValueError(
            f"{weights} holds other tensors than config.json describes ({len(different)}, the first "
            f"{different[0]!a:.80}: {held.get(different[0])} instead of {own.get(different[0])}): {REMEDY}"
        )
