"""LeRobot's policy types: which there are, and what opening and sampling one takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from lerobot.configs import PreTrainedConfig
from lerobot.utils.import_utils import register_third_party_plugins

from dualhead_envs.validated_json import shown


@dataclass(frozen=True)
class PolicyType:
    """What opening and sampling one policy type takes; the defaults are LeRobot's own conventions.

    Attributes:
        replaced: Fields of the configuration that are replaced, because following them would download or compile.
        steps_field: The field that says how many denoising steps a sample takes; None where a sample takes one pass.
        whole_chunk: Whether the policy cuts its chunk to ``n_action_steps``, so that this is widened to see all of it.
        time_first: Whether its chunks are (H, B, D).
        single_action: Whether it decides one action at a time, whose chunk is one step long.
        batch_rows: Rows of a batch at most.
    """

    replaced: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    steps_field: str | None = None
    whole_chunk: bool = False
    time_first: bool = False
    single_action: bool = False
    batch_rows: int = 1024


#: Weights of an image encoder come with the policy's own; the field's value would be fetched from elsewhere.
_ENCODER = {"pretrained_backbone_weights": None}

#: Types that differ from the conventions; every other registered type is opened by them.
POLICY_TYPES: Mapping[str, PolicyType] = MappingProxyType(
    {
        "act": PolicyType(MappingProxyType(_ENCODER)),
        "diffusion": PolicyType(
            MappingProxyType(_ENCODER | {"compile_model": False}), steps_field="num_inference_steps", whole_chunk=True
        ),
        "vqbet": PolicyType(MappingProxyType(_ENCODER)),
        # Plans by trying hundreds of action sequences a row.
        "tdmpc": PolicyType(time_first=True, batch_rows=32),
        "gaussian_actor": PolicyType(single_action=True),
    }
)


def require_policy_type(name: Any, source: str) -> PolicyType:
    """What the policy type called ``name`` takes, one of LeRobot's or of an installed plugin.

    Raises:
        ValueError: If nothing that is installed registers it.
    """
    # Importing the policies registers their configurations by name.
    import lerobot.policies  # noqa: F401

    if isinstance(name, str) and name not in PreTrainedConfig.get_known_choices():
        register_third_party_plugins()
    known = PreTrainedConfig.get_known_choices()
    if not isinstance(name, str) or name not in known:
        raise ValueError(
            f"{source} has type {shown(name)}, which no installed package registers (known: {', '.join(sorted(known))}"
            "): install the plugin that it comes from (a distribution lerobot_policy_*)"
        )
    return POLICY_TYPES.get(name, PolicyType())
