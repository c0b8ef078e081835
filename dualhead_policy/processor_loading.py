"""Safe loading of a folder's pre- and post-processor: only the steps that ours have, nothing that it names freely.

LeRobot's loader imports whatever class ``policy_preprocessor.json`` names and calls it with the arguments given there.
Here the two files are checked first: the steps of :func:`make_dualhead_pre_post_processors`, in their order, by
registry name, each with the arguments that it knows, and states from files of the folder itself.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.policies import make_pre_post_processors
from lerobot.processor import ProcessorStepRegistry
from lerobot.utils.import_utils import register_third_party_plugins
from pydantic import Field
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from dualhead_envs.dataset_sidecar import Count
from dualhead_envs.validated_json import Label, Schema, read_json, validated
from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.disagreement_step import REGISTRY_NAME as DISAGREEMENT_NAME
from dualhead_policy.hub_folder import file_inside
from dualhead_policy.kinematics.robot_file import FILE_SCHEME
from dualhead_policy.processor_dualhead import Processors

PREPROCESSOR_FILE, POSTPROCESSOR_FILE = "policy_preprocessor.json", "policy_postprocessor.json"
#: Registry name of the step that counts a policy's decisions; :mod:`lerobot_policy_dualhead` brings it to LeRobot.
CERTIFICATE_NAME = "coordination_certificate"
#: Registry names of steps that watch, which a policy may have or lack.
ATTACHED = (CERTIFICATE_NAME, DISAGREEMENT_NAME)
REMEDY = "load the folder that the policy was saved to"


class RenameOptions(Schema):
    rename_map: dict[Label, Label]


class NoOptions(Schema):
    pass


class DeviceOptions(Schema):
    device: Label
    float_dtype: Literal[None, "float32"] = None


class NormalizerOptions(Schema):
    eps: Annotated[float, Field(ge=0, le=1e-3)]
    features: dict[Label, PolicyFeature]
    norm_map: dict[FeatureType, NormalizationMode]


class Rename(Schema):
    registry_name: Literal["rename_observations_processor"]
    config: RenameOptions


class ToBatch(Schema):
    registry_name: Literal["to_batch_processor"]
    config: NoOptions


class ToDevice(Schema):
    registry_name: Literal["device_processor"]
    config: DeviceOptions


class Normalize(Schema):
    registry_name: Literal["normalizer_processor"]
    config: NormalizerOptions
    state_file: Label


class Unnormalize(Schema):
    registry_name: Literal["unnormalizer_processor"]
    config: NormalizerOptions
    state_file: Label


class DisagreementOptions(Schema):
    kinematic_map: Label
    joint: tuple[Count, Count]
    position: tuple[Count, Count]
    decision_steps: Annotated[int, Field(ge=1, le=10_000)]
    weight: Annotated[float, Field(gt=0, le=1)]
    limit_mm: Annotated[float, Field(ge=0)]


class Disagreement(Schema):
    registry_name: Literal["disagreement_monitor"]
    config: DisagreementOptions


class CertificateOptions(Schema):
    """What the step's constructor takes of a policy's folder; it checks partition, environment and state itself."""

    n_modes: Annotated[int, Field(ge=2, le=1000)] | None = None
    partition: dict[Label, Any] | None = None
    first: Label = "first"
    second: Label = "second"
    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.05
    state: dict[Label, Any] | None = None
    environment: dict[Label, Any] | None = None
    draws: Annotated[int, Field(ge=2, le=1000)]
    seed: Count = 0


class Certificate(Schema):
    registry_name: Literal["coordination_certificate"]
    config: CertificateOptions


class Preprocessor(Schema):
    """``policy_preprocessor.json``."""

    name: Literal["policy_preprocessor"]
    steps: tuple[Rename, ToBatch, ToDevice, Normalize]


class CertifiedPreprocessor(Schema):
    """``policy_preprocessor.json`` with a certificate of the policy's decisions, under raw observations."""

    name: Literal["policy_preprocessor"]
    steps: tuple[Rename, ToBatch, ToDevice, Certificate, Normalize]


class Postprocessor(Schema):
    """``policy_postprocessor.json``."""

    name: Literal["policy_postprocessor"]
    steps: tuple[Unnormalize, ToDevice]


class WatchedPostprocessor(Schema):
    """``policy_postprocessor.json`` with a monitor of the executed actions."""

    name: Literal["policy_postprocessor"]
    steps: tuple[Unnormalize, Disagreement, ToDevice]


def load_processors(folder: Path, config: DualheadConfig) -> Processors:
    """The pre- and the post-processor of a policy's folder, on the configuration's device.

    Args:
        folder: The policy's folder.
        config: Its configuration.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If a file names another step, has other options, or holds statistics that do not fit.
    """
    pre = _read_preprocessor(file_inside(folder, PREPROCESSOR_FILE))
    post = _read_postprocessor(file_inside(folder, POSTPROCESSOR_FILE), config)
    for file, step in ((PREPROCESSOR_FILE, pre.steps[-1]), (POSTPROCESSOR_FILE, post.steps[0])):
        own = {FeatureType(key): mode for key, mode in config.normalization_mapping.items()}
        if step.config.norm_map != own:
            raise ValueError(
                f"{folder / file} normalises by {_modes(step.config.norm_map)}, config.json by {_modes(own)}: {REMEDY}"
            )
        _check_state(file_inside(folder, step.state_file), config)
    return make_pre_post_processors(
        config,
        pretrained_path=str(folder),
        preprocessor_overrides={"device_processor": {"device": config.device}},
    )


def _read_preprocessor(path: Path) -> Preprocessor | CertifiedPreprocessor:
    document = read_json(path, kind="a dual-head policy's preprocessor", remedy=REMEDY)
    steps = document.get("steps") if isinstance(document, dict) else None
    if not isinstance(steps, list) or len(steps) != 5:
        return validated(document, Preprocessor, source=str(path), remedy=REMEDY)
    pre = validated(document, CertifiedPreprocessor, source=str(path), remedy=REMEDY)
    if CERTIFICATE_NAME not in ProcessorStepRegistry.list():
        register_third_party_plugins()
    try:
        ProcessorStepRegistry.get(CERTIFICATE_NAME)(**pre.steps[3].config.model_dump())
    except ValueError as error:
        raise ValueError(f"{path} has a certificate that is none ({error}): {REMEDY}") from error
    return pre


def _read_postprocessor(path: Path, config: DualheadConfig) -> Postprocessor | WatchedPostprocessor:
    document = read_json(path, kind="a dual-head policy's postprocessor", remedy=REMEDY)
    steps = document.get("steps") if isinstance(document, dict) else None
    watched = isinstance(steps, list) and len(steps) == 3
    if not watched:
        return validated(document, Postprocessor, source=str(path), remedy=REMEDY)
    post = validated(document, WatchedPostprocessor, source=str(path), remedy=REMEDY)
    named = post.steps[1].config.kinematic_map
    own = None if config.representation is None else config.representation.kinematic_map
    if named.startswith(FILE_SCHEME) or named != own:
        raise ValueError(f"{path} watches the kinematic map {named!r}, expected the policy's own, {own!r}: {REMEDY}")
    return post


def _modes(norm_map: dict[FeatureType, NormalizationMode]) -> dict[str, str]:
    return {feature.value: mode.value for feature, mode in norm_map.items()}


def _check_state(path: Path, config: DualheadConfig) -> None:
    """Refuse statistics with which observations would be normalised to nonsense."""
    try:
        state = load_file(path)
    except SafetensorError as error:
        raise ValueError(f"{path} is not a complete safetensors file: it may be truncated; {REMEDY}") from error
    for key, feature in (config.input_features or {}).items():
        if feature.type not in (FeatureType.STATE, FeatureType.ENV):
            continue
        for statistic in ("mean", "std"):
            name = f"{key}.{statistic}"
            _check_statistic(path, name, state.get(name), feature.shape)


def _check_statistic(path: Path, name: str, values: Tensor | None, shape: tuple[int, ...]) -> None:
    if values is None:
        raise ValueError(f"{path} lacks {name!r}, expected mean and std of every observation: {REMEDY}")
    if tuple(values.shape) != tuple(shape):
        raise ValueError(f"{path} holds {name!r} of shape {tuple(values.shape)}, expected {tuple(shape)}: {REMEDY}")
    if not values.is_floating_point():
        raise ValueError(f"{path} holds {name!r} of type {values.dtype}, expected floating-point numbers: {REMEDY}")
    if not torch.isfinite(values).all() or (name.endswith(".std") and not (values > 0).all()):
        expected = "positive finite numbers" if name.endswith(".std") else "finite numbers"
        raise ValueError(f"{path} holds {name!r} = {values.tolist()[:4]}, expected {expected}: {REMEDY}")
