"""Configuration of the dual-head flow-matching policy (``--policy.type=dualhead``)."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from lerobot.configs import FeatureType, NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamConfig
from lerobot.optim.schedulers import CosineAnnealingWithWarmupSchedulerConfig, LRSchedulerConfig

from dualhead_policy.representation import RepresentationLayout

CHOICES = {
    "conditioning": ("film", "concat"),
    "preconditioning": ("gaussian", "none"),
    "token": (None, "oracle", "window"),
    "token_draw": ("uniform", "marginal"),
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


@PreTrainedConfig.register_subclass("dualhead")
@dataclass
class DualheadConfig(PreTrainedConfig):
    """A policy that decodes one motion into joint space and into end-effector space with two heads.

    Attributes:
        chunk_size: H, actions in a chunk (sec:heads).
        n_action_steps: Actions executed before the next decision. None: 8, or the whole chunk where the
            layout's episodes are one chunk long (the ring).
        encoder_dim: Width of the condition encoder E(c).
        velocity_layers: Hidden layers of each head's velocity field.
        velocity_width: Units in each hidden layer.
        conditioning: ``"film"`` (time and context modulate every layer; trains faster) or ``"concat"`` (the
            paper's construction).
        preconditioning: ``"gaussian"`` (the field adds its network to the optimal linear velocity of one
            Gaussian of the data's scale) or ``"none"`` (the paper's bare network). See docs/choices.md.
        time_frequencies: Frequencies 1..n of the time features.
        source_noise_beta: beta of sec:heads: 1 independent source noise, 0 fully shared.
        token: Shared discrete token: None, ``"oracle"`` (the demonstration's mode) or ``"window"`` (k-means on
            the training windows' positions).
        n_tokens: Number of tokens; None: as many as the dataset has modes.
        token_draw: Distribution of tokens at sampling: ``"uniform"``, or ``"marginal"`` of the training data.
        token_replacement_prob: Probability that a training token is replaced by a uniformly random token.
        token_null_prob: Probability that a training token is replaced by the null token (all zeros).
        normalize_actions: ``"mean_std"``, ``"identity"``, or ``"auto"``: identity on the ring, where trained
            networks and the exact reference share one noise scale, mean_std elsewhere.
        action_std_floor: A standard deviation below this counts as 1 (constant dimensions).
        statistics: When fine-tuning on other data: ``"keep"`` the checkpoint's action scale or ``"replace"`` it.
        num_inference_steps: Euler steps (NFE).
        seed: Training draws are a function of (seed, step). None: torch's seed when the policy is built, which
            is ``--seed`` under ``lerobot-train`` and ``dualhead train``.
        representation: The dual action layout; None: read from the dataset.
        optimizer_lr, optimizer_betas, optimizer_grad_clip_norm: Adam's settings.
        lr_schedule, lr_warmup_steps: ``"cosine"`` to zero over the run, or ``"constant"``, after a warm-up.
    """

    chunk_size: int = 16
    n_action_steps: int | None = None

    encoder_dim: int = 256
    velocity_layers: int = 4
    velocity_width: int = 256
    conditioning: str = "film"
    preconditioning: str = "gaussian"
    time_frequencies: int = 10

    source_noise_beta: float = 1.0

    token: str | None = None
    n_tokens: int | None = None
    token_draw: str = "uniform"
    token_replacement_prob: float = 0.0
    token_null_prob: float = 0.0

    device: str | None = None

    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {
            "STATE": NormalizationMode.MEAN_STD,
            "ENV": NormalizationMode.MEAN_STD,
            "ACTION": NormalizationMode.IDENTITY,
        }
    )
    normalize_actions: str = "auto"
    action_std_floor: float = 1e-4
    statistics: str = "keep"

    num_inference_steps: int = 20
    seed: int | None = None
    representation: RepresentationLayout | None = None

    optimizer_lr: float = 2e-3
    optimizer_betas: tuple[float, float] = (0.9, 0.999)
    optimizer_grad_clip_norm: float = 10.0
    lr_schedule: str = "cosine"
    lr_warmup_steps: int = 200

    push_to_hub: bool = False

    def __post_init__(self) -> None:
        if self.device is None:
            # The base class would pick the same device, with a warning.
            accelerator = torch.accelerator.current_accelerator(check_available=True)
            self.device = accelerator.type if accelerator is not None else "cpu"
        super().__post_init__()
        for name, choices in CHOICES.items():
            value = getattr(self, name)
            if value not in choices:
                raise ValueError(f"policy.{name}={value!r} is not one of {list(choices)}: choose one of these")
        for name in PROBABILITIES:
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"policy.{name}={getattr(self, name)} is outside [0, 1]: give a value inside")
        for name in POSITIVE:
            if getattr(self, name) <= 0:
                raise ValueError(f"policy.{name}={getattr(self, name)} must be positive: give a larger value")
        if self.n_action_steps is not None and not 1 <= self.n_action_steps <= self.chunk_size:
            raise ValueError(
                f"policy.n_action_steps={self.n_action_steps} must lie in 1..chunk_size={self.chunk_size}: "
                "a policy cannot execute more actions than it predicts"
            )
        if self.token is None:
            for name in ("token_replacement_prob", "token_null_prob"):
                if getattr(self, name) > 0:
                    raise ValueError(
                        f"policy.{name}={getattr(self, name)} needs a token: set policy.token to 'oracle' or "
                        f"'window', or leave {name} at 0"
                    )
            if self.n_tokens is not None:
                raise ValueError(
                    f"policy.n_tokens={self.n_tokens} needs a token: set policy.token to 'oracle' or 'window', "
                    "or leave n_tokens out"
                )
        elif self.n_tokens is not None and self.n_tokens < 2:
            raise ValueError(f"policy.n_tokens={self.n_tokens} cannot coordinate anything: give at least 2")
        if self.token_replacement_prob + self.token_null_prob > 1:
            raise ValueError(
                f"policy.token_replacement_prob={self.token_replacement_prob} and "
                f"policy.token_null_prob={self.token_null_prob} add up to more than 1: lower one of them"
            )
        if self.normalization_mapping.get("ACTION") != NormalizationMode.IDENTITY:
            raise ValueError(
                "policy.normalization_mapping must leave ACTION as IDENTITY: the action scale lives inside the "
                "policy; set policy.normalize_actions instead"
            )

    @property
    def observation_delta_indices(self) -> None:
        return None

    @property
    def action_delta_indices(self) -> list[int]:
        return list(range(self.chunk_size))

    @property
    def reward_delta_indices(self) -> None:
        return None

    @property
    def drop_n_last_frames(self) -> int:
        """Keeps windows that would be padded beyond the episode's end out of training."""
        return self.chunk_size - 1

    def get_optimizer_preset(self) -> AdamConfig:
        return AdamConfig(
            lr=self.optimizer_lr, betas=self.optimizer_betas, grad_clip_norm=self.optimizer_grad_clip_norm
        )

    def get_scheduler_preset(self) -> LRSchedulerConfig | None:
        if self.lr_schedule == "constant":
            return None
        return CosineAnnealingWithWarmupSchedulerConfig(num_warmup_steps=self.lr_warmup_steps)

    def validate_features(self) -> None:
        """Check that there is a state to condition on and a dual action to predict.

        Raises:
            ValueError: In one sentence that names what is missing.
        """
        observed = [
            key
            for key, feature in (self.input_features or {}).items()
            if feature.type in (FeatureType.STATE, FeatureType.ENV)
        ]
        if not observed:
            raise ValueError(
                "the policy has no state to condition on: expected observation.state or "
                "observation.environment_state among policy.input_features"
            )
        if self.action_feature is None:
            raise ValueError("the policy has no output: expected the feature 'action' with the dual action vector")
