"""The processors of a policy of LeRobot's other types, of which every step is checked before LeRobot builds it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import torch
from lerobot.configs import PolicyFeature, PreTrainedConfig
from lerobot.policies import make_pre_post_processors
from pydantic import Field
from safetensors import SafetensorError
from safetensors.torch import load_file

from dualhead_envs.validated_json import Label, Schema, read_validated, shown
from dualhead_policy.hub_folder import file_inside
from dualhead_policy.processor_loading import (
    POSTPROCESSOR_FILE,
    PREPROCESSOR_FILE,
    Normalize,
    Rename,
    ToBatch,
    ToDevice,
    Unnormalize,
)

REMEDY = "load the folder that the policy was saved to; one of before LeRobot 0.4 has to be migrated with LeRobot first"

Step = Annotated[Rename | ToBatch | ToDevice | Normalize | Unnormalize, Field(discriminator="registry_name")]


class Pipeline(Schema):
    """``policy_preprocessor.json`` or ``policy_postprocessor.json``: steps that neither run code nor open files."""

    name: Label
    steps: Annotated[tuple[Step, ...], Field(max_length=16)]


def load_steps(folder: Path, config: PreTrainedConfig) -> tuple[Any, Any]:
    """The pre- and the post-processor of a policy's folder, on the configuration's device.

    Args:
        folder: The policy's folder.
        config: Its configuration.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If a file names another step, has other options, or holds statistics that are not finite.
    """
    overrides = {}
    observed, acted = config.input_features or {}, config.output_features or {}
    for file, kind, wanted in ((PREPROCESSOR_FILE, Normalize, observed), (POSTPROCESSOR_FILE, Unnormalize, acted)):
        pipeline = read_validated(file_inside(folder, file), Pipeline, kind="a policy's processor", remedy=REMEDY)
        for step in pipeline.steps:
            if isinstance(step, Normalize | Unnormalize):
                _check_features(folder / file, step.config.features, {**observed, **acted})
                _check_statistics(file_inside(folder, step.state_file))
        named = [set(step.config.features) for step in pipeline.steps if isinstance(step, kind)]
        if len(named) != 1 or not named[0] >= set(wanted):
            raise ValueError(
                f"{folder / file} has {len(named)} steps that scale, expected one that knows {sorted(wanted)}: {REMEDY}"
            )
        devices = any(isinstance(step, ToDevice) for step in pipeline.steps)
        overrides[file] = {"device_processor": {"device": config.device}} if devices else {}
    return make_pre_post_processors(
        config,
        pretrained_path=str(folder),
        preprocessor_overrides=overrides[PREPROCESSOR_FILE],
        postprocessor_overrides=overrides[POSTPROCESSOR_FILE],
    )


def _check_features(path: Path, features: Mapping[str, PolicyFeature], own: Mapping[str, PolicyFeature]) -> None:
    for key, feature in features.items():
        if key in own and tuple(feature.shape) != tuple(own[key].shape):
            raise ValueError(
                f"{path} normalises {key!a:.60} of shape {shown(list(feature.shape))}, config.json has "
                f"{list(own[key].shape)}: {REMEDY}"
            )


def _check_statistics(path: Path) -> None:
    try:
        state = load_file(path)
    except SafetensorError as error:
        raise ValueError(f"{path} is not a complete safetensors file: it may be truncated; {REMEDY}") from error
    for name, values in state.items():
        if not torch.isfinite(values).all():
            raise ValueError(f"{path} holds {name!a:.60} that is not finite, expected finite statistics: {REMEDY}")
