"""Which of LeRobot's policy types a stranger's folder may be of, and what is set aside while it is opened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True)
class PolicyType:
    """What opening and sampling one policy type takes.

    Attributes:
        replaced: Fields of the configuration that are replaced, because following them would download or compile.
        steps_field: The field that says how many denoising steps a sample takes; None where a sample takes one pass.
        whole_chunk: Whether the policy cuts its chunk to ``n_action_steps``, so that this is widened to see all of it.
    """

    replaced: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    steps_field: str | None = None
    whole_chunk: bool = False


#: Weights of an image encoder come with the policy's own; the field's value would be fetched from elsewhere.
_ENCODER = {"pretrained_backbone_weights": None}

#: The types whose modules were read: nothing in them runs code or opens a file that a configuration names.
POLICY_TYPES: Mapping[str, PolicyType] = MappingProxyType(
    {
        "act": PolicyType(MappingProxyType(_ENCODER)),
        "diffusion": PolicyType(
            MappingProxyType(_ENCODER | {"compile_model": False}), steps_field="num_inference_steps", whole_chunk=True
        ),
        "vqbet": PolicyType(MappingProxyType(_ENCODER)),
    }
)


def require_policy_type(name: Any, source: str) -> PolicyType:
    """The policy type called ``name``.

    Raises:
        ValueError: If a folder of this type cannot be opened without trusting it.
    """
    if not isinstance(name, str) or name not in POLICY_TYPES:
        raise ValueError(
            f"{source} has type {name!a:.60}, expected 'dualhead' or one of {sorted(POLICY_TYPES)}, whose folders run "
            "no code when they are opened: load the policy yourself and evaluate it in Python (docs/any_policy.md)"
        )
    return POLICY_TYPES[name]
