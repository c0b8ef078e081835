"""The configuration of a policy of LeRobot's other types, read from a folder that may be somebody else's."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import draccus
from lerobot.configs import FeatureType, PreTrainedConfig

from dualhead_envs.validated_json import Label, read_json, shown, validated
from dualhead_policy.hub_folder import file_inside
from dualhead_policy.lerobot_policies.offline import FetchError
from dualhead_policy.lerobot_policies.policy_types import PolicyType, require_policy_type

REMEDY = "load the folder that the policy was saved to"
#: Largest number in a configuration that sizes a network.
LARGEST = 65_536
#: Largest number of layers, and longest list of widths.
MOST_LAYERS = 256
#: Fields that training alone reads.
_TRAINING = re.compile(r"(optimizer|scheduler)_.*|n_vqvae_training_steps")
#: A word, which can be neither a path nor an address nor OWNER/NAME on a hub.
_WORD = re.compile(r"[\w-]{0,40}")
#: Fields of every configuration, of which opening a policy reads none that names anything.
_COMMON = {field.name for field in fields(PreTrainedConfig)}
_FEATURES = {"observation.state": FeatureType.STATE, "observation.environment_state": FeatureType.ENV}


def read_policy_type(folder: Path) -> Any:
    """The ``type`` in a policy's ``config.json``.

    Raises:
        FileNotFoundError: If it is missing.
        ValueError: If it is no JSON object.
    """
    return _document(folder).get("type")


def read_lerobot_configuration(folder: Path, *, device: str) -> tuple[PreTrainedConfig, PolicyType]:
    """The configuration in a folder, and what its type takes.

    Args:
        folder: The policy's folder.
        device: Where the policy is to run.

    Raises:
        FileNotFoundError: If it is missing.
        ValueError: If nothing installed registers its type, or a field is unknown, holds what it cannot, or names a
            file, an address or a repository other than the type's own default.
    """
    source = str(folder / "config.json")
    document = _document(folder)
    policy_type = require_policy_type(document.pop("type", None), source)
    name = _document(folder)["type"]
    if document.get("use_peft"):
        raise ValueError(
            f"{source} has use_peft: true, expected a whole policy: merge the adapter into its policy first"
        )
    replaced = {key: value for key, value in policy_type.replaced.items() if key in document}
    config_class = PreTrainedConfig.get_choice_class(name)
    default = _defaults(config_class)
    _check_chosen({key: value for key, value in document.items() if key not in replaced}, default, source)
    kept = {"device": device, "pretrained_path": None, "push_to_hub": False}
    try:
        config = draccus.decode(config_class, document | replaced | kept)
    except (ImportError, FetchError):
        raise
    except Exception as error:  # draccus and the configurations raise what they like; all of it is about the file
        raise ValueError(
            f"{source} is no configuration of type {name!r} ({shown(str(error), 200)}): {REMEDY}"
        ) from error
    encoded = draccus.encode(config, type(config))
    numeric = {field.name for field in fields(config) if isinstance(field.default, int | float)}
    for field, value in document.items():
        # draccus converts what it can, 1.5 to 1, and lets a word stand for some numbers.
        word = field in numeric and not isinstance(value, int | float | None)
        if field not in replaced | kept and (word or not _same(encoded.get(field), value)):
            raise ValueError(
                f"{source} has {field} = {shown(value)}, which a {name!r} policy reads as {shown(encoded.get(field))}: "
                f"{REMEDY}"
            )
    _check_features(config, source)
    return config, policy_type


def _document(folder: Path) -> dict[str, Any]:
    source = file_inside(folder, "config.json")
    document = read_json(source, kind="a policy's configuration", remedy=REMEDY)
    return validated(document, dict[Label, Any], source=str(source), remedy=REMEDY)


def _defaults(config_class: type) -> dict[str, Any]:
    """The fields' defaults as JSON has them, without making a configuration; a type's own code may fetch then."""
    defaults: dict[str, Any] = {}
    for field in fields(config_class):
        default: Any = field.default
        if field.default_factory is not MISSING:
            default = field.default_factory()
        defaults[field.name] = None if default is MISSING else draccus.encode(default)
    return defaults


def _check_chosen(document: dict[str, Any], default: dict[str, Any], source: str) -> None:
    """Bound what a folder chooses: numbers that size a network, and words, but nothing that its policy could open.

    Raises:
        ValueError: If a field differs from the type's default, and holds too large a number, or text that could be a
            path, an address or a repository.
    """
    for field, value in document.items():
        if _TRAINING.fullmatch(field) or _same(default.get(field), value):
            continue
        for name, number in _numbers(value, field):
            limit = MOST_LAYERS if "layer" in name else LARGEST
            if isinstance(number, int) and abs(number) > limit:
                raise ValueError(f"{source} has {name} = {shown(number)}, expected at most {limit}: {REMEDY}")
        if field not in _COMMON and not all(map(_WORD.fullmatch, _texts(value))):
            raise ValueError(
                f"{source} has {field} = {shown(value)}, expected numbers, words, or the type's own default "
                f"({shown(default.get(field))}): a folder may not name files or addresses; load the policy yourself "
                "and evaluate it in Python (docs/any_policy.md)"
            )


def _texts(value: Any) -> Iterator[str]:
    """Every text of a JSON value."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _texts(item)


def _numbers(value: Any, field: str = "") -> Iterator[tuple[str, Any]]:
    """Every number of a JSON value with the name of its field."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _numbers(item, key if not field else f"{field}.{key}")
    elif isinstance(value, list):
        yield f"the length of {field}, layers", len(value)
        for item in value:
            yield from _numbers(item, field)
    else:
        yield field, value


def _same(read: Any, given: Any) -> bool:
    """Whether two JSON values are one; false is 0, since LeRobot has integers that default to it."""
    if isinstance(read, dict) and isinstance(given, dict):
        return read.keys() == given.keys() and all(_same(read[key], given[key]) for key in read)
    if isinstance(read, list | tuple) and isinstance(given, list):
        return len(read) == len(given) and all(map(_same, read, given))
    return bool(read == given)


def _check_features(config: PreTrainedConfig, source: str) -> None:
    """Refuse observations and actions without a proper shape."""
    action = config.action_feature
    if action is None or len(action.shape) != 1:
        raise ValueError(f"{source} has no action of one axis among its output_features: {REMEDY}")
    for key, feature in (config.input_features or {}).items():
        expected = _FEATURES.get(key, FeatureType.VISUAL)
        axes = 3 if expected is FeatureType.VISUAL else 1
        if feature.type is not expected or len(feature.shape) != axes or min(feature.shape, default=0) < 1:
            raise ValueError(
                f"{source} has the observation {shown(key)} of type {feature.type.value} and shape "
                f"{shown(list(feature.shape))}, expected {sorted(_FEATURES)} with one axis, or images with three: "
                f"{REMEDY}"
            )
