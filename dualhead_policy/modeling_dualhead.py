"""The dual-head flow-matching policy as LeRobot knows it (``--policy.type=dualhead``): a shell around its model."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from huggingface_hub import ModelCard
from lerobot.configs import FeatureType
from lerobot.policies import PreTrainedPolicy
from lerobot.utils.constants import ACTION
from torch import Tensor, distributed

from dualhead_envs.recording.shards import write_atomically
from dualhead_policy.checkpoint_loading import load_strictly
from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.decision_hooks import DecisionHooks
from dualhead_policy.fitting.configuration import fill_in_defaults, note_origin, resolve_representation
from dualhead_policy.fitting.scales import fit_scales
from dualhead_policy.fitting.tokens import new_tokens
from dualhead_policy.flow.coupling import SharedDraws
from dualhead_policy.flow.diagnostics import latent_sensitivity, teacher_forced_residuals
from dualhead_policy.flow.draw_rule import StepDraws
from dualhead_policy.flow.draws import draw_step
from dualhead_policy.flow.episode_draws import EpisodeDraws
from dualhead_policy.flow.loss import training_loss
from dualhead_policy.flow.solver import condition_velocity, numpy_field, sample_chunks
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.model.dualhead_model import DualheadModel
from dualhead_policy.model_card import model_card
from dualhead_policy.sampling import HeadSamples, SamplingCoupling, refuse_keywords

#: Training steps between two measurements of what is logged beside the loss.
MEASURE_EVERY = 200


class DualheadPolicy(PreTrainedPolicy):
    """One motion, decoded by a joint head and a position head with their own velocity fields (sec:heads).

    Args:
        config: The configuration; fields left at None are resolved here and saved with the checkpoint.
        dataset_stats: Statistics of the training data, for a new policy.
        dataset_meta: Metadata of the training data, for a new policy: action names, and episodes for tokens.

    Attributes:
        decision_hooks, monitor_samples: Who is shown every closed-loop decision, and how many pairs.

    Raises:
        ValueError: If the data lack a dual action vector, have another layout than the configuration, or lack
            the statistics or labels that the configuration needs.
    """

    config_class = DualheadConfig
    name = "dualhead"
    config: DualheadConfig

    def __init__(
        self,
        config: DualheadConfig,
        dataset_stats: Mapping[str, Mapping[str, Any]] | None = None,
        dataset_meta: Any | None = None,
        **_: Any,
    ):
        super().__init__(config)
        config.validate_features()
        is_new = config.representation is None
        self.representation = resolve_representation(config, dataset_meta)
        if dataset_meta is not None:
            note_origin(config, dataset_meta)
        fill_in_defaults(config, self.representation, is_new=is_new)
        self.observation_keys = [
            key
            for key, feature in config.input_features.items()
            if feature.type in (FeatureType.STATE, FeatureType.ENV)
        ]
        observation_dim = sum(config.input_features[key].shape[0] for key in self.observation_keys)
        self.register_buffer("training_step", torch.zeros((), dtype=torch.int64))
        tokens = new_tokens(config, self.representation.slices["position"], dataset_meta)
        self._transport = None if tokens is None else tokens.transport
        if tokens is not None and tokens.episode_token is not None:
            # Needed in training only: rebuilt from the dataset, not part of the checkpoint.
            self.register_buffer("episode_token", tokens.episode_token, persistent=False)
        self.model = DualheadModel(config, self.representation, observation_dim, tokens.table if tokens else None)
        if is_new:
            self.model.kinematics.require()
        fit_scales(self.model, self.observation_keys, dataset_stats, dataset_meta)
        self.decision_hooks = DecisionHooks()
        self.monitor_samples = 1
        self.reset()

    # --- construction and loading ------------------------------------------------------------------------

    @classmethod
    def _load_as_safetensor(cls, model: Any, model_file: str, map_location: str, strict: bool) -> Any:
        # LeRobot asks for a lenient load; a policy with tensors missing would run and be wrong.
        policy: DualheadPolicy = model
        scales = policy.model.scales
        fitted = {name: buffer.clone() for name, buffer in scales.named_buffers()}
        load_strictly(policy, model_file)
        policy.model.kinematics = KinematicMap.load(policy.representation.kinematic_map, Path(model_file).parent)
        if policy.config.statistics == "replace":
            scales.load_state_dict(fitted)
        if policy._transport is not None and policy.model.tokens is not None:
            # The numbers of a new clustering mean nothing to this checkpoint's heads: its own centroids decide.
            tokens = policy.model.tokens
            policy.episode_token = tokens.assign(policy._transport.to(tokens.centroids.device))
        return policy

    def _save_pretrained(self, save_directory: Path, state_dict: dict[str, Tensor] | None = None) -> None:
        super()._save_pretrained(save_directory, state_dict=state_dict)
        self.model.kinematics.save(save_directory)
        self.write_card(save_directory)

    def write_card(self, folder: Path, results: Mapping[str, float | str] | None = None) -> Path:
        """Write the model card, ``README.md``, into this policy's folder; returns its path.

        Args:
            folder: The folder.
            results: Protocol numbers by name, where they are known.
        """
        card = folder / "README.md"
        write_atomically(card, self._card(results))
        return card

    def generate_model_card(self, *_: Any, **__: Any) -> ModelCard:
        """LeRobot's generic card says nothing about a plugin: this is the folder's own (``push_to_hub`` asks)."""
        return ModelCard(self._card())

    def _card(self, results: Mapping[str, float | str] | None = None) -> str:
        usage = None if self.model.tokens is None else self.model.tokens.marginal.tolist()
        return model_card(self.config, step=int(self.training_step), token_usage=usage, results=results)

    def get_optim_params(self) -> Any:
        return self.parameters()

    # --- training ----------------------------------------------------------------------------------------

    def forward(self, batch: Mapping[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """The training loss on a batch of preprocessed observations and physical action windows.

        Args:
            batch: Observations (B, dim) and ``action`` (B, H, D); ``episode_index`` (B,) for oracle and
                episode tokens.
            reduction: ``"mean"``, the only one: free bits act on the batch, so that a window has no loss of its own.

        Returns:
            The loss, and the share of each head and mechanism.

        Raises:
            ValueError: If an action is not finite, the windows have another shape, or another reduction is asked for.
        """
        if reduction != "mean":
            raise ValueError(
                f"forward(reduction={reduction!r}) asks a dualhead policy for a loss per window, expected 'mean': "
                "train without --sample_weighting"
            )
        action = batch[ACTION]
        expected = (self.config.chunk_size, len(self.representation.names))
        if action.shape[1:] != expected:
            raise ValueError(
                f"the batch holds actions of shape {tuple(action.shape[1:])}, expected (H, D) = {expected}: train "
                "on a dataset of the policy's layout"
            )
        if not torch.isfinite(action).all():
            raise ValueError("the batch holds a non-finite action: drop that episode or record the dataset again")
        observation = self._observation(batch)
        token = self._training_tokens(batch)
        loss, parts = self.compute_loss(observation, action, token)
        report = {f"loss_{name}": part.item() for name, part in parts.items()}
        if self.training_step % MEASURE_EVERY == 0:
            for quantity, values in self.measure(observation, action, token).items():
                report |= {f"{quantity}_{name}": value for name, value in values.items()}
        return loss, report

    def compute_loss(
        self, observation: Tensor, action: Tensor, token: Tensor | None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss of the current training step and its parts; see :func:`dualhead_policy.flow.loss.training_loss`."""
        draws = self.draw_step(observation, action, has_tokens=token is not None)
        return training_loss(self.model, observation, action, token, draws)

    def draw_step(self, observation: Tensor, action: Tensor, *, has_tokens: bool) -> StepDraws:
        """The draws of the current training step; see :func:`dualhead_policy.flow.draws.draw_step`."""
        return draw_step(self.model, observation, action, has_tokens=has_tokens, **self._draw_key())

    def _draw_key(self) -> dict[str, int]:
        # Under accelerate every process sees other windows: their noise and times must differ too.
        rank = distributed.get_rank() if distributed.is_available() and distributed.is_initialized() else 0
        return {"seed": self.config.seed or 0, "step": int(self.training_step), "rank": rank}

    def measure(self, observation: Tensor, action: Tensor, token: Tensor | None) -> dict[str, dict[str, float]]:
        """What training logs beside the loss: ``residual`` (teacher-forced) and, with a latent, its sensitivity."""
        measured = {"residual": teacher_forced_residuals(self.model, observation, action, token, **self._draw_key())}
        if self.model.shared_latent is not None:
            measured["latent_sensitivity"] = latent_sensitivity(self.model, observation, action, **self._draw_key())
        return measured

    def update(self) -> None:
        """Advance the training step; LeRobot calls this after every optimiser step."""
        self.training_step += 1

    def _training_tokens(self, batch: Mapping[str, Tensor]) -> Tensor | None:
        if self.model.tokens is None:
            return None
        if self.config.token == "window":
            return self.model.tokens.assign(batch[ACTION][..., self.model.head_slices["position"]])
        if not hasattr(self, "episode_token"):
            raise ValueError(
                f"the {self.config.token} token needs the training episodes: build the policy with the dataset's "
                "metadata (lerobot-train and dualhead train do)"
            )
        return self.episode_token[batch["episode_index"].flatten()]

    def _observation(self, batch: Mapping[str, Tensor]) -> Tensor:
        missing = [key for key in self.observation_keys if key not in batch]
        if missing:
            raise ValueError(
                f"the batch lacks {missing}: expected the preprocessed observations {self.observation_keys}"
            )
        observation = torch.cat([batch[key].flatten(1) for key in self.observation_keys], dim=-1)
        if not torch.isfinite(observation).all():
            raise ValueError(
                f"the observations {self.observation_keys} hold a non-finite value, expected finite ones: check the "
                "sensor, or drop that frame"
            )
        return self.model.observed(observation)

    # --- sampling ----------------------------------------------------------------------------------------

    @torch.no_grad()
    def sample(
        self,
        batch: Mapping[str, Tensor],
        num_samples: int,
        *,
        num_steps: int | None = None,
        coupling: SamplingCoupling | None = None,
        generator: torch.Generator | None = None,
    ) -> HeadSamples:
        """Sample chunks of both heads.

        Args:
            batch: Preprocessed observations of B conditions, as the policy's preprocessor returns them.
            num_samples: N chunks per condition and head; sample n of the heads belong together.
            num_steps: Euler steps; None: ``config.num_inference_steps``.
            coupling: What the heads share; None: as the policy was configured.
            generator: Source of all draws; None: torch's global generator.

        Returns:
            Samples in physical units, on the policy's device.
        """
        steps = num_steps or self.config.num_inference_steps
        return sample_chunks(
            self.model, self._observation(batch), num_samples, steps, coupling or SamplingCoupling(), generator
        )

    def velocity_field(
        self, batch: Mapping[str, Tensor], head: str = "position", *, token: Tensor | None = None, latent: Any = None
    ) -> Callable[[np.ndarray, float], np.ndarray]:
        """A head's velocity field, for scores that compare the fields of ensemble members (VFD).

        Args:
            batch: Preprocessed observations of N conditions (repeat one for many samples of it).
            head: ``"joint"``, ``"position"`` or ``"rotation"``.
            token: Token of every row (N,), for a policy with tokens.
            latent: Latent of every row (N, dim), for a policy with a latent.

        Returns:
            A function of states (N, H, d), in the coordinates of the source noise, and a time in [0, 1) to velocities
            (N, H, d), both NumPy arrays, as :func:`dualhead_eval.ensembles.scores.vfd_score` takes it.

        Raises:
            ValueError: If the policy has no such head, or needs a token or latent that is not given.
        """
        field = condition_velocity(self.model, self._observation(batch), head, SharedDraws(token, latent))
        return numpy_field(field, next(self.parameters()))

    @torch.no_grad()
    def draw_tokens(
        self, batch: Mapping[str, Tensor], num_samples: int, generator: torch.Generator | None = None
    ) -> Tensor | None:
        """Tokens (B, num_samples) for preprocessed observations, as ``config.token_draw`` says; None without tokens."""
        if self.model.tokens is None:
            return None
        return self.model.draw_tokens(self.model.embed(self._observation(batch)), num_samples, generator)

    @torch.no_grad()
    def token_probabilities(self, batch: Mapping[str, Tensor]) -> Tensor | None:
        """With which probabilities (B, n_tokens) :meth:`draw_tokens` draws each token; None without tokens."""
        if self.model.tokens is None:
            return None
        return self.model.token_probabilities(self.model.embed(self._observation(batch)))

    # --- closed loop -------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Forget the queued actions and what the episode shares (called at every environment reset)."""
        self._queue: deque[Tensor] = deque()
        self._held = EpisodeDraws()
        self.decision_hooks.begin()

    @torch.no_grad()
    def predict_action_chunk(self, batch: Mapping[str, Tensor], **given: Any) -> Tensor:
        """One dual action chunk (B, H, D) per row, in physical units.

        Tokens and latents are drawn per row at the first decision after :meth:`reset` and held through the episode;
        window tokens belong to a window and are drawn at every decision.

        Raises:
            ValueError: If given one source noise, where the heads have one each.
        """
        refuse_keywords("predict_action_chunk", given)
        coupling = self._held.coupling(self.model, self._observation(batch))
        samples = self.sample(batch, 1, coupling=coupling)
        self.decision_hooks.show(self, batch, samples)
        return self.dual_chunk(samples)

    def dual_chunk(self, samples: HeadSamples) -> Tensor:
        """The first of every condition's samples as dual action chunks (B, H, D), in physical units.

        Without a rotation head the rotation slots hold the start orientation: the one that the first joint
        configuration predicted after :meth:`reset` has, kept until the next reset.
        """
        groups = [samples.joint[:, 0], samples.position[:, 0]]
        if self.representation.rotation:
            held = self._held.orientation(self.model, samples) if samples.rotation is None else samples.rotation[:, 0]
            groups.append(held)
        if samples.gripper is not None:
            groups.append(samples.gripper[..., None])
        return torch.cat(groups, dim=-1)

    @torch.no_grad()
    def select_action(self, batch: Mapping[str, Tensor], **given: Any) -> Tensor:
        """The next dual action (B, D): a new chunk every ``n_action_steps`` steps.

        Raises:
            ValueError: If given one source noise, where the heads have one each.
        """
        refuse_keywords("select_action", given)
        self.eval()
        if not self._queue:
            chunk = self.predict_action_chunk(batch)
            self._queue.extend(chunk[:, : self.config.n_action_steps].unbind(1))
        return self._queue.popleft()
