"""Checks of single configuration fields: what each may hold, refused in one sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from lerobot.configs import FeatureType

from dualhead_policy.sampling import NOISE_ALIGNMENTS, TOKEN_DRAWS

#: Beyond it an embedding saturates whatever it enters.
LARGEST_GAIN = 100.0
CHOICES = {
    "conditioning": ("film", "concat"),
    "preconditioning": ("auto", "linear_gaussian", "gaussian", "none"),
    "token": (None, "oracle", "episode", "window"),
    "token_positions": ("absolute", "displacement"),
    "token_draw": TOKEN_DRAWS,
    "source_noise_alignment": (None, *NOISE_ALIGNMENTS),
    "latent": (None, "prior", "posterior"),
    "consistency_norm": ("normalized", "meters"),
    "rotation_noise": ("coupled", "private"),
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
NOT_NEGATIVE = (
    "latent_dim",
    "kl_weight",
    "free_bits",
    "consistency_weight",
    "rotation_consistency_weight",
    "optimizer_grad_clip_norm",
    "lr_warmup_steps",
)
#: Largest values: what is larger is a slip of the keyboard, or a folder that is meant to exhaust the memory.
AT_MOST = {
    "chunk_size": 1024,
    "encoder_dim": 16_384,
    "velocity_width": 16_384,
    "velocity_layers": 128,
    "time_frequencies": 64,
    "num_inference_steps": 10_000,
    "n_tokens": 1024,
    "latent_dim": 4096,
    "seed": 2**63 - 1,
}
#: Most parameters of the heads' velocity fields together.
MOST_PARAMETERS = 10**9
#: Longest observation or action, in numbers.
WIDEST_FEATURE = 100_000


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
    for name in (*NOT_NEGATIVE, "seed"):
        if fields[name] is not None and not fields[name] >= 0:
            raise ValueError(f"policy.{name}={fields[name]} must not be negative: give 0 or more")
    for name, most in AT_MOST.items():
        if fields[name] is not None and fields[name] > most:
            raise ValueError(f"policy.{name}={fields[name]} is larger than {most}: give a smaller value")
    for name, value in fields.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"policy.{name}={value} is not a finite number: give one")
    for name in ("dataset_name", "environment", "kinematic_map"):
        if fields[name] is not None and not fields[name].isprintable():
            raise ValueError(f"policy.{name}={fields[name]!a} holds control codes: give printable text")
    _check_features(fields)
    if not all(0 <= beta < 1 for beta in fields["optimizer_betas"]):
        raise ValueError(
            f"policy.optimizer_betas={fields['optimizer_betas']} is outside [0, 1): give two values inside"
        )
    gain = fields["embedding_gain"]
    if gain is not None and not 0 < gain <= LARGEST_GAIN:
        raise ValueError(f"policy.embedding_gain={gain} is outside (0, {LARGEST_GAIN:g}]: give a number inside")
    noise = fields["observation_noise"]
    if noise is not None and not noise >= 0:
        raise ValueError(f"policy.observation_noise={noise} must not be negative: give 0 or more")


def _check_features(fields: Mapping[str, Any]) -> None:
    for group in ("input_features", "output_features"):
        for key, feature in (fields[group] or {}).items():
            if feature.type is FeatureType.VISUAL:
                continue  # left alone by the policy
            if not feature.shape or min(feature.shape) < 1 or math.prod(feature.shape) > WIDEST_FEATURE:
                raise ValueError(
                    f"policy.{group}[{key!r}] has shape {list(feature.shape)}, expected 1 to {WIDEST_FEATURE} numbers: "
                    "give the shape of the dataset's feature"
                )
