"""Configuration of the dual-head flow-matching policy (``--policy.type=dualhead``)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import torch
from lerobot.configs import FeatureType, NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamConfig
from lerobot.optim.schedulers import CosineAnnealingWithWarmupSchedulerConfig, LRSchedulerConfig

from dualhead_policy.configuration_checks import MOST_PARAMETERS, check_values
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.representation import RepresentationLayout


@PreTrainedConfig.register_subclass("dualhead")
@dataclass
class DualheadConfig(PreTrainedConfig):
    """A policy that decodes one motion into joint space and into end-effector space with two heads.

    Attributes:
        chunk_size: H, actions in a chunk (sec:heads).
        n_action_steps: Actions executed before the next decision. None: 8, or the whole chunk where the
            layout's episodes are one chunk long (the ring).
        padded_steps: Actions of a training window that may lie beyond its episode's end, where the last action is
            repeated (the robot holds). Without them no window begins in an episode's last frames, and a policy in
            closed loop does not know how to finish. None: 0 on the ring, as many as possible elsewhere.
        encoder_dim: Width of the condition encoder E(c).
        velocity_layers: Hidden layers of each head's velocity field.
        velocity_width: Units in each hidden layer.
        conditioning: ``"film"`` (time and context modulate every layer; trains faster) or ``"concat"`` (the
            paper's construction).
        embedding_gain: Factor on E(c), of any policy with it. None: 8 for film on a ring of three or more modes, whose
            tokens stay unread at 1 (docs/choices.md), else 1.
        preconditioning: What the field adds its network to: ``"gaussian"``, the optimal linear velocity of one
            Gaussian of each dimension's scale; ``"linear_gaussian"``, that of the training windows' linear
            regression on the observation (see ``chunk_frame``); ``"none"``, nothing, the paper's bare network;
            ``"auto"``: gaussian on the ring, linear_gaussian elsewhere. None of them changes the loss's minimiser.
        time_frequencies: Frequencies 1..n of the time features.
        observation_noise: Standard deviation of Gaussian noise on the normalised observation in training. A policy
            that has only seen exact states learns to continue from wherever it is and drifts in closed loop; with
            noise it returns to the demonstrations. None: 0 on the ring, OBSERVATION_NOISE elsewhere.
        source_noise_beta: beta of sec:heads: 1 independent source noise, 0 fully shared.
        source_noise_alignment: ``"kinematic"``: what is shared goes from the joint head to the others through the
            kinematic map (:mod:`dualhead_policy.flow.noise_alignment`); None: coordinate by coordinate.
        token: Shared discrete token: None, ``"oracle"`` (the demonstration's mode), ``"episode"`` (k-means on whole
            transport trajectories) or ``"window"`` (k-means on the training windows' positions).
        token_positions: What window tokens cluster: ``"absolute"``, the window's positions; or ``"displacement"``, its
            positions less the first, each axis divided by its standard deviation.
        n_tokens: Number of tokens; None: as many as the dataset has modes.
        token_draw: Distribution of tokens at sampling: ``"uniform"``; ``"marginal"``, their frequency in the
            training data; or ``"learned"``, a categorical prior given the observation, trained by cross-entropy.
        token_replacement_prob: Probability that a training token is replaced by a uniformly random token.
        token_null_prob: Probability that a training token is replaced by the null token (all zeros).
        token_nmi: Normalised mutual information of the training tokens with the demonstrations' modes; filled in
            when tokens are fitted, for the model card.
        latent: Shared continuous latent: None, ``"prior"`` (standard normal, independent of the data) or
            ``"posterior"`` (amortised Gaussian posterior in training, standard normal at sampling).
        latent_dim: Its dimensions; 0 is the anchor, whose heads see 32 zeros in its place.
        kl_weight: Weight of the posterior's divergence from the standard normal, in nats summed over dimensions.
        free_bits: Nats of each latent dimension that are not penalised.
        consistency_weight: lambda of eq:cons: weight of the squared distance between the position of the joint head's
            clean endpoint and the position head's, at the same time and sample, all times weighing alike.
        consistency_norm: W of eq:cons: ``"normalized"``, the units of the position head's own flow loss, so that the
            same lambda weighs both alike on every layout (on robots the inverse variance of the position targets; on
            the ring, whose actions are not normalised, metres); or ``"meters"``.
        rotation_head: Whether a third head predicts the orientation, by flow matching on its 6-D representation.
        rotation_consistency_weight: Weight of the squared geodesic angle (rad^2) between the rotation of the joint
            head's clean endpoint and the rotation head's.
        rotation_noise: ``"coupled"``: the rotation head's source noise is coupled to the others' by
            ``source_noise_beta``; ``"private"``: it is its own (tab:pose does not say which).
        kinematic_map: The map from joints to the position, instead of the one that the dataset's names imply: for a
            robot of your own ``"file:PATH#LINK"`` with its URDF or MJCF.
        normalize_actions: ``"mean_std"``, ``"identity"``, or ``"auto"``: identity on the ring, where trained
            networks and the exact reference share one noise scale, mean_std elsewhere.
        action_std_floor: A standard deviation below this counts as 1 (constant dimensions).
        statistics: When fine-tuning on other data: ``"keep"`` the checkpoint's action scale or ``"replace"`` it.
        num_inference_steps: Euler steps (NFE).
        seed: Training draws are a function of (seed, step). None: torch's seed when the policy is built, which
            is ``--seed`` under ``lerobot-train`` and ``dualhead train``.
        representation: The dual action layout; None: read from the dataset.
        dataset_name, environment: What the policy was trained on, for its model card; filled in from the dataset.
        optimizer_lr, optimizer_betas, optimizer_grad_clip_norm: Adam's settings.
        lr_schedule, lr_warmup_steps: ``"cosine"`` to zero over the run, or ``"constant"``, after a warm-up.
    """

    #: How pydantic checks the configuration of a policy's folder.
    __pydantic_config__: ClassVar = {"extra": "forbid", "allow_inf_nan": False}

    chunk_size: int = 16
    n_action_steps: int | None = None
    padded_steps: int | None = None

    encoder_dim: int = 256
    velocity_layers: int = 4
    velocity_width: int = 256
    conditioning: str = "film"
    embedding_gain: float | None = None
    preconditioning: str = "auto"
    time_frequencies: int = 10

    observation_noise: float | None = None
    source_noise_beta: float = 1.0
    source_noise_alignment: str | None = None

    token: str | None = None
    token_positions: str = "absolute"
    n_tokens: int | None = None
    token_draw: str = "uniform"
    token_replacement_prob: float = 0.0
    token_null_prob: float = 0.0
    token_nmi: float | None = None

    latent: str | None = None
    latent_dim: int = 16
    kl_weight: float = 1.0
    free_bits: float = 0.0

    consistency_weight: float = 0.0
    consistency_norm: str = "normalized"
    rotation_head: bool = False
    rotation_consistency_weight: float = 0.0
    rotation_noise: str = "coupled"
    kinematic_map: str | None = None

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
    dataset_name: str | None = None
    environment: str | None = None

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
        try:
            torch.device(self.device)
        except RuntimeError as error:
            raise ValueError(
                f"policy.device={self.device!r} is no device of torch: give 'cpu', 'cuda' or 'mps'"
            ) from error
        super().__post_init__()
        check_values(vars(self))
        _check_together(self)

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
    def private_noise_heads(self) -> tuple[str, ...]:
        """Heads whose source noise is their own whatever ``source_noise_beta``."""
        return ("rotation",) if self.rotation_noise == "private" else ()

    @property
    def drop_n_last_frames(self) -> int:
        """Keeps windows that would be padded beyond ``padded_steps`` out of training."""
        return self.chunk_size - 1 - (self.padded_steps or 0)

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


def _check_together(config: DualheadConfig) -> None:
    """Refuse fields that contradict each other.

    Raises:
        ValueError: In one sentence that names the fields, what they hold and what to do.
    """
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
    parameters = 3 * config.velocity_layers * config.velocity_width**2
    if parameters > MOST_PARAMETERS:
        raise ValueError(
            f"policy.velocity_layers={config.velocity_layers} and policy.velocity_width={config.velocity_width} make "
            f"{parameters:.1e} parameters, expected at most {MOST_PARAMETERS:.0e}: give smaller ones"
        )
    _check_tokens(config)
    _check_latent(config)
    if config.rotation_consistency_weight > 0 and not config.rotation_head:
        raise ValueError(
            f"policy.rotation_consistency_weight={config.rotation_consistency_weight} compares the joint head with a "
            "rotation head: set policy.rotation_head=true, or leave the weight at 0"
        )
    if config.source_noise_alignment is not None and config.source_noise_beta == 1:
        raise ValueError(
            f"policy.source_noise_alignment={config.source_noise_alignment!r} is about noise that the heads share, and "
            "policy.source_noise_beta=1 shares none: set policy.source_noise_beta=0, or leave the alignment out"
        )
    if config.rotation_noise == "private" and not config.rotation_head:
        raise ValueError(
            "policy.rotation_noise='private' is that of a rotation head: set policy.rotation_head=true, or leave it at "
            "'coupled'"
        )
    if config.kinematic_map is not None:
        try:
            KinematicMap(config.kinematic_map)
        except ValueError as error:
            raise ValueError(f"policy.kinematic_map={config.kinematic_map!r}: {error}") from error
    if config.normalization_mapping.get("ACTION") != NormalizationMode.IDENTITY:
        raise ValueError(
            "policy.normalization_mapping must leave ACTION as IDENTITY: the action scale lives inside the "
            "policy; set policy.normalize_actions instead"
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
