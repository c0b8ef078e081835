"""What a configuration's fields may be, alone and together: refused when it is built, in one sentence."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lerobot.configs import NormalizationMode

if TYPE_CHECKING:
    from dualhead_policy.configuration_dualhead import DualheadConfig

CHOICES = {
    "conditioning": ("film", "concat"),
    "preconditioning": ("auto", "linear_gaussian", "gaussian", "none"),
    "token": (None, "oracle", "episode", "window"),
    "token_positions": ("absolute", "displacement"),
    "token_draw": ("uniform", "marginal", "learned"),
    "latent": (None, "prior", "posterior"),
    "consistency_norm": ("whitened", "meters"),
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


def check_fields(config: DualheadConfig) -> None:
    """Refuse values that do not exist and fields that contradict each other.

    Raises:
        ValueError: In one sentence that names the field, what it holds and what to do.
    """
    _check_values(config)
    _check_tokens(config)
    _check_latent(config)
    if config.rotation_consistency_weight > 0 and not config.rotation_head:
        raise ValueError(
            f"policy.rotation_consistency_weight={config.rotation_consistency_weight} compares the joint head with a "
            "rotation head: set policy.rotation_head=true, or leave the weight at 0"
        )
    if config.kinematic_map is not None and config.kinematic_map.startswith("file:"):
        from dualhead_policy.kinematics.robot_file import parse_robot_file, robot_file_position

        path, _ = parse_robot_file(config.kinematic_map)
        # A trained policy runs without its robot's file: only training and evaluation need the kinematics.
        if config.representation is None or path.is_file():
            robot_file_position(config.kinematic_map)
    if config.normalization_mapping.get("ACTION") != NormalizationMode.IDENTITY:
        raise ValueError(
            "policy.normalization_mapping must leave ACTION as IDENTITY: the action scale lives inside the "
            "policy; set policy.normalize_actions instead"
        )


def _check_values(config: DualheadConfig) -> None:
    for name, choices in CHOICES.items():
        value = getattr(config, name)
        if value not in choices:
            raise ValueError(f"policy.{name}={value!r} is not one of {list(choices)}: choose one of these")
    for name in PROBABILITIES:
        if not 0 <= getattr(config, name) <= 1:
            raise ValueError(f"policy.{name}={getattr(config, name)} is outside [0, 1]: give a value inside")
    for name in POSITIVE:
        if not getattr(config, name) > 0:
            raise ValueError(f"policy.{name}={getattr(config, name)} must be positive: give a larger value")
    for name in NOT_NEGATIVE:
        if not getattr(config, name) >= 0:
            raise ValueError(f"policy.{name}={getattr(config, name)} must not be negative: give 0 or more")
    if config.observation_noise is not None and not config.observation_noise >= 0:
        raise ValueError(f"policy.observation_noise={config.observation_noise} must not be negative: give 0 or more")
    if config.n_action_steps is not None and not 1 <= config.n_action_steps <= config.chunk_size:
        raise ValueError(
            f"policy.n_action_steps={config.n_action_steps} must lie in 1..chunk_size={config.chunk_size}: "
            "a policy cannot execute more actions than it predicts"
        )
    if config.padded_steps is not None and not 0 <= config.padded_steps < config.chunk_size:
        raise ValueError(
            f"policy.padded_steps={config.padded_steps} must lie in 0..chunk_size-1={config.chunk_size - 1}: a window "
            "has at least one recorded action"
        )


def _check_tokens(config: DualheadConfig) -> None:
    if config.token_positions != "absolute" and config.token != "window":
        raise ValueError(
            f"policy.token_positions={config.token_positions!r} belongs to policy.token='window', not to "
            f"{config.token!r}: leave it out"
        )
    if config.token is None:
        given = {name: getattr(config, name) for name in ("token_replacement_prob", "token_null_prob")}
        given = {name: value for name, value in given.items() if value > 0}
        if config.n_tokens is not None:
            given["n_tokens"] = config.n_tokens
        if config.token_draw == "learned":
            given["token_draw"] = config.token_draw
        for name, value in given.items():
            raise ValueError(
                f"policy.{name}={value} needs a token: set policy.token to 'oracle', 'episode' or 'window', or leave "
                f"{name} out"
            )
        return
    if config.n_tokens is not None and config.n_tokens < 2:
        raise ValueError(f"policy.n_tokens={config.n_tokens} cannot coordinate anything: give at least 2")
    if config.token_replacement_prob + config.token_null_prob > 1:
        raise ValueError(
            f"policy.token_replacement_prob={config.token_replacement_prob} and "
            f"policy.token_null_prob={config.token_null_prob} add up to more than 1: lower one of them"
        )


def _check_latent(config: DualheadConfig) -> None:
    if config.latent is not None and config.token is not None:
        raise ValueError(
            f"policy.latent={config.latent!r} and policy.token={config.token!r} are two shared variables: choose one "
            "of them"
        )
    if config.latent == "posterior" and config.latent_dim == 0:
        raise ValueError("policy.latent='posterior' needs something to infer: set policy.latent_dim, for example to 16")
    if config.latent != "posterior" and config.free_bits > 0:
        raise ValueError(
            f"policy.free_bits={config.free_bits} belongs to policy.latent='posterior', not to {config.latent!r}: "
            "leave it at 0"
        )
