"""Load a trained policy with its processors from a hub folder, quietly and strictly."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

from dualhead_envs.validated_json import read_json, validated
from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.hub_folder import downloaded_folder, file_inside
from dualhead_policy.modeling_dualhead import DualheadPolicy
from dualhead_policy.processor_loading import load_processors

REMEDY = "load the folder that the policy was saved to"


def policy_folder(path: str | Path) -> Path:
    """The hub folder that ``path`` means: itself, a training run's newest checkpoint, or a download.

    A name OWNER/NAME that is no folder here is a repository on the hub, of which the policy's files alone are fetched.

    Raises:
        FileNotFoundError: If there is no policy.
    """
    path = Path(path)
    for folder in (path, path / "pretrained_model", path / "checkpoints" / "last" / "pretrained_model"):
        if (folder / "config.json").is_file():
            return folder.resolve()
    downloaded = None if path.exists() else downloaded_folder(path)
    if downloaded is not None and (downloaded / "config.json").is_file():
        return downloaded.resolve()
    raise FileNotFoundError(
        f"{path} holds no policy (no config.json): give a checkpoint's pretrained_model folder, or a run's "
        "output folder"
    )


def load_policy(path: str | Path, *, device: str = "cpu") -> tuple[DualheadPolicy, Any]:
    """Load a policy and its preprocessor.

    The folder may be somebody else's: no code of it is run, and no file outside it is opened.

    Args:
        path: As :func:`policy_folder` accepts it.
        device: Where the policy runs.

    Raises:
        FileNotFoundError: If there is no policy, or it lacks a file.
        ValueError: If the configuration has unknown keys or is of another policy, the weights do not belong
            to it, or its processors are not a dual-head policy's.
    """
    folder = policy_folder(path)
    config = read_configuration(folder, device=device)
    with contextlib.redirect_stdout(None):
        policy = DualheadPolicy.from_pretrained(folder, config=config)
        preprocessor, _ = load_processors(folder, config)
    return policy, preprocessor


def read_configuration(folder: Path, *, device: str) -> DualheadConfig:
    """The configuration of a trained policy, ``config.json`` of its folder.

    Raises:
        FileNotFoundError: If it is missing.
        ValueError: If it is of another policy, or one of its fields is unknown or holds what it cannot.
    """
    source = file_inside(folder, "config.json")
    document = read_json(source, kind="a dualhead configuration", remedy=REMEDY)
    if not isinstance(document, dict) or document.pop("type", None) != "dualhead":
        raise ValueError(f"{source} holds no policy of type 'dualhead': give a dual-head policy")
    config = validated(document | {"device": device}, DualheadConfig, source=str(source), remedy=REMEDY)
    if config.representation is None:
        raise ValueError(f"{source} has no representation, expected that of a trained policy: {REMEDY}")
    return config
