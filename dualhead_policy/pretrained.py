"""Load a trained policy with its processors from a hub folder, quietly and strictly."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import draccus
from lerobot.configs import PreTrainedConfig
from lerobot.policies import make_pre_post_processors

from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.modeling_dualhead import DualheadPolicy


def policy_folder(path: str | Path) -> Path:
    """The hub folder that ``path`` means: itself, or the newest checkpoint of a training run's output folder.

    Raises:
        FileNotFoundError: If there is no policy.
    """
    path = Path(path)
    for folder in (path, path / "pretrained_model", path / "checkpoints" / "last" / "pretrained_model"):
        if (folder / "config.json").is_file():
            return folder.resolve()
    raise FileNotFoundError(
        f"{path} holds no policy (no config.json): give a checkpoint's pretrained_model folder, or a run's "
        "output folder"
    )


def load_policy(path: str | Path, *, device: str = "cpu") -> tuple[DualheadPolicy, Any]:
    """Load a policy and its preprocessor.

    Args:
        path: As :func:`policy_folder` accepts it.
        device: Where the policy runs.

    Raises:
        FileNotFoundError: If there is no policy, or it lacks its weights.
        ValueError: If the configuration has unknown keys or is of another policy, or the weights do not belong
            to it.
    """
    folder = policy_folder(path)
    try:
        config = PreTrainedConfig.from_pretrained(folder, cli_overrides=[f"--device={device}"])
    except (draccus.utils.DecodingError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(
            f"{folder / 'config.json'} is not a dualhead configuration ({reason}): load the folder that the "
            "policy was saved to"
        ) from error
    if not isinstance(config, DualheadConfig):
        raise ValueError(
            f"{folder} holds a policy of type {config.type!r}, expected 'dualhead': give a dual-head policy"
        )
    with contextlib.redirect_stdout(None):
        policy = DualheadPolicy.from_pretrained(folder, config=config)
        preprocessor, _ = make_pre_post_processors(
            config,
            pretrained_path=str(folder),
            preprocessor_overrides={"device_processor": {"device": device}},
        )
    return policy, preprocessor
