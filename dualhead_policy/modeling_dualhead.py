"""The dual-head flow-matching policy as LeRobot knows it (``--policy.type=dualhead``)."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import torch
from lerobot.configs import FeatureType
from lerobot.policies import PreTrainedPolicy
from lerobot.utils.constants import ACTION
from torch import Tensor

from dualhead_policy.action_scale import ActionScale
from dualhead_policy.checkpoint_loading import load_strictly
from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.flow_matching import coupled_source_noise, integrate_euler, interpolate
from dualhead_policy.heads import DualheadNetwork
from dualhead_policy.keyed_random import keyed_generator
from dualhead_policy.representation import RepresentationLayout
from dualhead_policy.sampling import HeadSamples, SamplingCoupling
from dualhead_policy.token_fitting import episode_modes, fit_tokens
from dualhead_policy.tokens import TokenTable

#: Rows integrated together while sampling: small enough for the activations to stay in cache.
SAMPLING_ROWS = 2048


class DualheadPolicy(PreTrainedPolicy):
    """One motion, decoded by a joint head and a position head with their own velocity fields (sec:heads).

    Args:
        config: The configuration; fields left at None are resolved here and saved with the checkpoint.
        dataset_stats: Statistics of the training data, for a new policy.
        dataset_meta: Metadata of the training data, for a new policy: action names, and episodes for tokens.

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
        self.representation = self._resolve_representation(dataset_meta)
        if config.n_action_steps is None:
            one_chunk_episodes = self.representation.kinematic_map.startswith("ring/")
            config.n_action_steps = config.chunk_size if one_chunk_episodes else min(8, config.chunk_size)
        if config.seed is None:
            config.seed = torch.initial_seed() % 2**31
        self.observation_keys = [
            key
            for key, feature in config.input_features.items()
            if feature.type in (FeatureType.STATE, FeatureType.ENV)
        ]
        slices = self.representation.slices
        self.head_slices = {head: slices[head] for head in ("joint", "position")}
        self.head_dims = {head: part.stop - part.start for head, part in self.head_slices.items()}
        self.register_buffer("training_step", torch.zeros((), dtype=torch.int64))
        self.action_scale = ActionScale(len(self.representation.names))
        if dataset_stats is not None:
            self.fit_action_scale(dataset_stats)
        elif dataset_meta is not None:
            raise ValueError("the dataset comes without statistics: expected meta/stats.json; record the dataset again")
        self.tokens = self._make_tokens(dataset_meta)
        self.network = DualheadNetwork(
            sum(config.input_features[key].shape[0] for key in self.observation_keys),
            self.head_dims,
            chunk_size=config.chunk_size,
            token_dim=self.tokens.n_tokens if self.tokens is not None else 0,
            encoder_dim=config.encoder_dim,
            width=config.velocity_width,
            n_layers=config.velocity_layers,
            n_frequencies=config.time_frequencies,
            conditioning=config.conditioning,
            preconditioned=config.preconditioning == "gaussian",
        )
        self.reset()

    # --- construction and loading ------------------------------------------------------------------------

    def _resolve_representation(self, dataset_meta: Any | None) -> RepresentationLayout:
        config = self.config
        if dataset_meta is not None:
            given = RepresentationLayout.from_names(dataset_meta.features[ACTION].get("names"))
            if config.representation is None:
                config.representation = given
            config.representation.require_same(given, owner="the policy", given=f"dataset {dataset_meta.repo_id}")
        if config.representation is None:
            raise ValueError(
                "a new dualhead policy needs a dataset to learn its action layout from: give --dataset.repo_id "
                "and --dataset.root, or load a trained policy with --policy.path"
            )
        given_name = getattr(config.action_feature, "layout_name", None)
        if given_name is not None and given_name != config.representation.kinematic_map:
            raise ValueError(
                f"the environment's layout is {given_name!r}, the policy's is "
                f"{config.representation.kinematic_map!r}: evaluate in the environment and representation that the "
                "policy was trained on"
            )
        width = config.action_feature.shape[0]
        if width != len(config.representation.names):
            raise ValueError(
                f"the environment or dataset has {width} action dimensions, the policy's "
                f"{config.representation.kinematic_map!r} layout has {len(config.representation.names)}: use the "
                "environment and representation that the policy was trained on"
            )
        return config.representation

    def fit_action_scale(self, stats: Mapping[str, Mapping[str, Any]]) -> None:
        """Set the action scale from dataset statistics; the ring and rotations stay in physical units."""
        mode = self.config.normalize_actions
        if mode == "auto":
            mode = "identity" if self.representation.kinematic_map.startswith("ring/") else "mean_std"
        rotation = set(self.representation.rotation)
        normalized = [mode == "mean_std" and name not in rotation for name in self.representation.names]
        self.action_scale.fit(stats, normalized=normalized, std_floor=self.config.action_std_floor)

    def _make_tokens(self, dataset_meta: Any | None) -> TokenTable | None:
        config = self.config
        if config.token is None:
            return None
        if dataset_meta is None:
            if config.n_tokens is None:
                raise ValueError("policy.n_tokens is missing from the configuration: give the number of tokens")
            window_dim = config.chunk_size * self.head_dims["position"] if config.token == "window" else 0
            return TokenTable(config.n_tokens, window_dim)
        if config.token == "oracle":
            # Needed in training only: rebuilt from the dataset, not part of the checkpoint.
            self.register_buffer("episode_mode", episode_modes(dataset_meta.root), persistent=False)
        return fit_tokens(config, dataset_meta.root, self.head_slices["position"])

    @classmethod
    def _load_as_safetensor(cls, model: Any, model_file: str, map_location: str, strict: bool) -> Any:
        # LeRobot asks for a lenient load; a policy with tensors missing would run and be wrong.
        fitted = {name: buffer.clone() for name, buffer in model.action_scale.named_buffers()}
        load_strictly(model, model_file, map_location)
        if model.config.statistics == "replace":
            model.action_scale.load_state_dict(fitted)
        return model

    def get_optim_params(self) -> Any:
        return self.parameters()

    # --- training ----------------------------------------------------------------------------------------

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, float]]:
        """The training loss on a batch of preprocessed observations and physical action windows.

        Args:
            batch: Observations (B, dim) and ``action`` (B, H, D); ``episode_index`` (B,) for oracle tokens.

        Returns:
            The loss, and each head's share of it.

        Raises:
            ValueError: If an action is not finite or the windows have another shape.
        """
        action = batch[ACTION]
        expected = (self.config.chunk_size, len(self.representation.names))
        if action.shape[1:] != expected:
            raise ValueError(
                f"the batch holds actions of shape {tuple(action.shape[1:])}, expected (H, D) = {expected}: train "
                "on a dataset of the policy's layout"
            )
        if not torch.isfinite(action).all():
            raise ValueError("the batch holds a non-finite action: drop that episode or record the dataset again")
        loss, parts = self.compute_loss(self._observation(batch), action, self._training_tokens(batch))
        return loss, {f"loss_{head}": part.item() for head, part in parts.items()}

    def compute_loss(
        self, observation: Tensor, action: Tensor, token: Tensor | None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Flow-matching loss (eq:cfm), the sum over heads of the mean squared error per coordinate.

        The draws (noise, time, token corruption) are a function of (seed, training step).

        Args:
            observation: Preprocessed observations (B, C).
            action: Dual action windows (B, H, D) in physical units.
            token: Clean tokens (B,), or None.
        """
        config = self.config
        purpose = "train" if self.training else "validate"
        generator = keyed_generator(config.seed or 0, int(self.training_step), purpose, device=action.device)
        n = len(action)
        time = torch.rand(n, generator=generator, device=action.device).to(action.dtype)
        noise = coupled_source_noise((n, config.chunk_size), self.head_dims, config.source_noise_beta, generator)
        context = self.network.encoder(observation)
        if self.tokens is not None and token is not None:
            token = self.tokens.corrupt(
                token,
                replacement_prob=config.token_replacement_prob,
                null_prob=config.token_null_prob,
                generator=generator,
            )
            context = torch.cat([context, self.tokens.one_hot(token)], dim=-1)
        normalized = self.action_scale.normalize(action)
        parts = {}
        for head, part in self.head_slices.items():
            target, source = normalized[..., part], noise[head].to(action.dtype)
            x = interpolate(source, target, time).flatten(1)
            modulation = self.network.modulation(head, time, context)
            velocity = self.network.velocity(head, x, time[:, None], modulation, self._spread(head))
            parts[head] = (velocity - (target - source).flatten(1)).square().mean()
        return sum(parts.values(), torch.zeros((), device=action.device)), parts

    def update(self) -> None:
        """Advance the training step; LeRobot calls this after every optimiser step."""
        self.training_step += 1

    def _training_tokens(self, batch: Mapping[str, Tensor]) -> Tensor | None:
        if self.tokens is None:
            return None
        if self.config.token == "window":
            return self.tokens.assign(batch[ACTION][..., self.head_slices["position"]])
        if not hasattr(self, "episode_mode"):
            raise ValueError(
                "the oracle token needs the modes of the training episodes: build the policy with the dataset's "
                "metadata (lerobot-train and dualhead train do)"
            )
        return self.episode_mode[batch["episode_index"].flatten()]

    def _spread(self, head: str) -> Tensor:
        return self.action_scale.spread[self.head_slices[head]].repeat(self.config.chunk_size)

    def _observation(self, batch: Mapping[str, Tensor]) -> Tensor:
        missing = [key for key in self.observation_keys if key not in batch]
        if missing:
            raise ValueError(
                f"the batch lacks {missing}: expected the preprocessed observations {self.observation_keys}"
            )
        return torch.cat([batch[key].flatten(1) for key in self.observation_keys], dim=-1)

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
        coupling = coupling or SamplingCoupling()
        num_steps = num_steps or self.config.num_inference_steps
        observation = self._observation(batch)
        n_conditions, device = len(observation), observation.device
        leading = (n_conditions, num_samples)
        source = dict(coupling.source_noise or {})
        if not source:
            beta = coupling.source_noise_beta
            beta = self.config.source_noise_beta if beta is None else beta
            source = coupled_source_noise((*leading, self.config.chunk_size), self.head_dims, beta, generator)
        token = self._sampling_tokens(leading, coupling, generator)
        context = self._contexts(observation)
        per_chunk = max(1, SAMPLING_ROWS // num_samples)
        heads: dict[str, Tensor] = {}
        for head, part in self.head_slices.items():
            noise = source[head].to(device).flatten(2)
            pieces = [
                self._integrate(
                    head,
                    noise[start : start + per_chunk],
                    context[start : start + per_chunk],
                    token[head][start : start + per_chunk] if token else None,
                    num_steps,
                )
                for start in range(0, n_conditions, per_chunk)
            ]
            chunk = torch.cat(pieces).unflatten(-1, (self.config.chunk_size, -1))
            heads[head] = self.action_scale.unnormalize(chunk, part)
        return HeadSamples(heads["joint"], heads["position"], token=token["joint"] if token else None)

    def _sampling_tokens(
        self, leading: tuple[int, int], coupling: SamplingCoupling, generator: torch.Generator | None
    ) -> dict[str, Tensor] | None:
        if self.tokens is None:
            if coupling.token is not None:
                raise ValueError("the policy has no token to follow: sample it without coupling.token")
            return None
        device = self.training_step.device
        token = coupling.token
        if token is None:
            token = self.tokens.draw(leading, self.config.token_draw, generator)
        second = token
        if not coupling.share_token:
            second = self.tokens.draw(leading, self.config.token_draw, generator)
        return {"joint": token.to(device), "position": second.to(device)}

    def _contexts(self, observation: Tensor) -> Tensor:
        """Contexts (B, T, C) of every condition, one for each of T tokens (T = 1 without tokens)."""
        encoded = self.network.encoder(observation)[:, None]
        if self.tokens is None:
            return encoded
        codes = self.tokens.one_hot(torch.arange(self.tokens.n_tokens, device=observation.device))
        n, t = len(encoded), len(codes)
        return torch.cat([encoded.expand(n, t, -1), codes.expand(n, t, -1)], dim=-1)

    def _integrate(self, head: str, noise: Tensor, context: Tensor, token: Tensor | None, num_steps: int) -> Tensor:
        rows = torch.arange(len(noise), device=noise.device)[:, None]
        spread = self._spread(head)

        def velocity(x: Tensor, time: float) -> Tensor:
            now = torch.tensor(time, device=x.device)
            modulation = self.network.modulation(head, now, context)
            if token is not None:
                modulation = [part[rows, token] for part in modulation]
            return self.network.velocity(head, x, now, modulation, spread)

        return integrate_euler(velocity, noise, num_steps)

    # --- closed loop -------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Forget the queued actions and the episode's shared token (called at every environment reset)."""
        self._queue: deque[Tensor] = deque()
        self._episode_token: Tensor | None = None

    @torch.no_grad()
    def predict_action_chunk(self, batch: Mapping[str, Tensor], **_: Any) -> Tensor:
        """One dual action chunk (B, H, D) per row, in physical units.

        The token is drawn per row at the first decision after :meth:`reset` and held through the episode.
        """
        n = len(self._observation(batch))
        if self.tokens is not None and (self._episode_token is None or len(self._episode_token) != n):
            self._episode_token = self.tokens.draw((n, 1), self.config.token_draw, None)
        samples = self.sample(batch, 1, coupling=SamplingCoupling(token=self._episode_token))
        return self.dual_chunk(samples)

    def dual_chunk(self, samples: HeadSamples) -> Tensor:
        """The first of every condition's samples as dual action chunks (B, H, D), in physical units."""
        return torch.cat([samples.joint[:, 0], samples.position[:, 0]], dim=-1)

    @torch.no_grad()
    def select_action(self, batch: Mapping[str, Tensor], **_: Any) -> Tensor:
        """The next dual action (B, D): a new chunk every ``n_action_steps`` steps."""
        self.eval()
        if not self._queue:
            chunk = self.predict_action_chunk(batch)
            self._queue.extend(chunk[:, : self.config.n_action_steps].unbind(1))
        return self._queue.popleft()
