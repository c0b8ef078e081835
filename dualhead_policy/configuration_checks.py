"""Checks of single configuration fields: what each may hold, refused in one sentence."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

CHOICES = {
    "conditioning": ("film", "concat"),
    "preconditioning": ("auto", "linear_gaussian", "gaussian", "none"),
    "token": (None, "oracle", "episode", "window"),
    "token_positions": ("absolute", "displacement"),
    "token_draw": ("uniform", "marginal", "learned"),
    "latent": (None, "prior", "posterior"),
    "consistency_norm": ("normalized", "meters"),
    "lr_schedule": ("cosine", "constant"),
    "normalize_actions": ("auto", "mean_std", "identity"),
    "statistics": ("keep", "replace"),
}
PROBABILITIES = ("source_noise_beta", "token_replacement_prob", "token_null_prob")
POSITIVE = (
    "chunk_size",
    "encoder_dim",
    "velocity_width",
    "velocity_layers",
    "time_frequencies",
    "num_inference_steps",
    "optimizer_lr",
    "action_std_floor",
)
NOT_NEGATIVE = ("latent_dim", "kl_weight", "free_bits", "consistency_weight", "rotation_consistency_weight")


def check_values(fields: Mapping[str, Any]) -> None:
    """Refuse values that do not exist.

    Args:
        fields: Values by the configuration's field names.

    Raises:
        ValueError: In one sentence that names the field, what it holds and what to do.
    """
    for name, choices in CHOICES.items():
        value = fields[name]
        if value not in choices:
            raise ValueError(f"policy.{name}={value!r} is not one of {list(choices)}: choose one of these")
    for name in PROBABILITIES:
        if not 0 <= fields[name] <= 1:
            raise ValueError(f"policy.{name}={fields[name]} is outside [0, 1]: give a value inside")
    for name in POSITIVE:
        if not fields[name] > 0:
            raise ValueError(f"policy.{name}={fields[name]} must be positive: give a larger value")
    for name in NOT_NEGATIVE:
        if not fields[name] >= 0:
            raise ValueError(f"policy.{name}={fields[name]} must not be negative: give 0 or more")
    noise = fields["observation_noise"]
    if noise is not None and not noise >= 0:
        raise ValueError(f"policy.observation_noise={noise} must not be negative: give 0 or more")
