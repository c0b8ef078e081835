"""What the LeRobot configurations of all our environments share: features and processors from the layout."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import gymnasium as gym
import torch
from lerobot.configs import FeatureType, PipelineFeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.processor import PolicyActionProcessorStep, PolicyProcessorPipeline
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE

from dualhead_envs.layout import Layout


class DualActionFeature(PolicyFeature):
    """The dual action vector as a policy feature that also knows its layout.

    LeRobot hands this very object to the policy as ``output_features["action"]``, so that a policy can refuse
    an environment whose actions have the same width but another meaning, or that observes something else.
    ``layout_name`` and ``observation_widths`` are no dataclass fields: configurations are written and read
    without them.
    """

    layout_name: str = ""
    observation_widths: Mapping[str, int] = MappingProxyType({})


class ExecutedActionStep(PolicyActionProcessorStep):
    """Takes the dual action vector (B, D) to the part (B, width) that the environment's control executes.

    Args:
        layout: Layout of the dual action vector.
        control: One of the layout's controls.

    Raises:
        ValueError: When called with an action of another width than the layout's.
    """

    def __init__(self, layout: Layout, control: str):
        self.layout = layout
        self.control = control
        self._indices = torch.from_numpy(layout.control_indices(control))

    def action(self, action: torch.Tensor) -> torch.Tensor:
        names = self.layout.action_names
        if action.shape[-1] != len(names):
            raise ValueError(
                f"the policy returned actions of width {action.shape[-1]}, expected the {len(names)} "
                f"dimensions of layout {self.layout.name} ({', '.join(names)}): choose the env.type, or for "
                "the ring the env.representation, that the policy was trained on"
            )
        return action[..., self._indices.to(action.device)]

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Declares the executed width."""
        shape = (len(self._indices),)
        return {
            kind: {key: PolicyFeature(f.type, shape) if f.type is FeatureType.ACTION else f for key, f in group.items()}
            for kind, group in features.items()
        }


@dataclass
class DualheadEnvConfig(EnvConfig):
    """Base of our ``--env.type`` choices: declares the dual action vector, executes what ``control`` names.

    Subclasses define :attr:`layout`, and ``gym_kwargs`` for the environment itself; ``task`` is the
    Gymnasium id.
    """

    fps: int = 20
    control: str = "joint"
    render_mode: str = "rgb_array"

    @property
    @abc.abstractmethod
    def layout(self) -> Layout:
        """The layout of the environment's observations and actions."""

    def __post_init__(self) -> None:
        layout = self.layout
        layout.control_groups(self.control)
        self.fps = layout.fps
        action = DualActionFeature(FeatureType.ACTION, (len(layout.action_names),))
        action.layout_name = layout.name
        action.observation_widths = {OBS_STATE: len(layout.agent_pos), OBS_ENV_STATE: len(layout.environment_state)}
        # Always rebuilt: a configuration read from a file must not change what the environment is.
        self.features = {
            "agent_pos": PolicyFeature(FeatureType.STATE, (len(layout.agent_pos),)),
            "environment_state": PolicyFeature(FeatureType.ENV, (len(layout.environment_state),)),
            "action": action,
        }
        self.features_map = {"agent_pos": OBS_STATE, "environment_state": OBS_ENV_STATE, "action": ACTION}

    @property
    def package_name(self) -> str:
        """Importing this package registers the ids, in this process and in asynchronous workers."""
        return "dualhead_envs"

    @property
    def gym_id(self) -> str:
        if self.task is None:
            raise ValueError(f"env.type={self.type} has no env.task: set it to the Gymnasium id to make")
        return self.task

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        """LeRobot's vector environment; its workers unpickle a call of ``gym.make``, not this configuration.

        Unpickling the configuration would import LeRobot in every worker, seconds each.
        """
        make = partial(
            gym.make, f"dualhead_envs:{self.gym_id}", disable_env_checker=self.disable_env_checker, **self.gym_kwargs
        )
        autoreset = gym.vector.AutoresetMode.SAME_STEP
        vector: gym.vector.VectorEnv
        if use_async_envs and n_envs > 1:
            vector = gym.vector.AsyncVectorEnv([make] * n_envs, context="forkserver", autoreset_mode=autoreset)
        else:
            vector = gym.vector.SyncVectorEnv([make] * n_envs, autoreset_mode=autoreset)
        return {self.type: {0: vector}}

    def get_env_processors(self) -> tuple[PolicyProcessorPipeline, PolicyProcessorPipeline]:
        """Observations pass unchanged; of the dual action vector the controlled part is executed."""
        step = ExecutedActionStep(self.layout, self.control)
        return PolicyProcessorPipeline(steps=[]), PolicyProcessorPipeline(steps=[step])
