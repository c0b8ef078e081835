"""The layout of observations and of the dual action vector: one object, many uses.

A :class:`Layout` names every dimension of an environment once, with its unit, bounds and frame. Gymnasium
spaces, LeRobotDataset features, policy features and the tables in the docstrings are all generated from it,
so that none of them can drift from the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import gymnasium as gym
import numpy as np

#: The parts of the dual action vector, in their order inside it.
ACTION_GROUPS = ("joint", "position", "rotation", "gripper")


@dataclass(frozen=True)
class Dimension:
    """One scalar of an observation or action: ``name``, ``unit``, bounds and what it means (with its frame)."""

    name: str
    unit: str
    low: float
    high: float
    meaning: str


@dataclass(frozen=True)
class Layout:
    """What one environment observes and what both decodings of an action look like.

    Attributes:
        name: Identifies the layout in checkpoints and datasets, for example ``"panda"`` or ``"ring/polar"``.
        agent_pos: Proprioception (``observation.state`` in LeRobot's words).
        environment_state: Task context (``observation.environment_state``).
        action: The dual action vector by group; keys are a subset of :data:`ACTION_GROUPS`, in that order.
        controls: Which groups each control mode executes, for example ``{"joint": ("joint", "gripper")}``.
        kinematic_map: The map from head A's space to the position, for example ``"panda"``, ``"ring/polar"``.
        fps: Control rate in Hz.
        frame: The frame in which positions and rotations are expressed.
    """

    name: str
    agent_pos: tuple[Dimension, ...]
    environment_state: tuple[Dimension, ...]
    action: Mapping[str, tuple[Dimension, ...]]
    controls: Mapping[str, tuple[str, ...]]
    kinematic_map: str
    fps: int
    frame: str

    @property
    def action_names(self) -> list[str]:
        """Names of the dual action vector's dimensions, in order."""
        return [dimension.name for group in self.action.values() for dimension in group]

    @property
    def action_slices(self) -> dict[str, slice]:
        """Where each group lies in the dual action vector."""
        slices, start = {}, 0
        for group, dimensions in self.action.items():
            slices[group] = slice(start, start + len(dimensions))
            start += len(dimensions)
        return slices

    def control_groups(self, control: str) -> tuple[str, ...]:
        """The groups that ``control`` executes.

        Raises:
            ValueError: If the layout has no such control.
        """
        if control not in self.controls:
            raise ValueError(
                f"control={control!r} is not one of {sorted(self.controls)} for the {self.name} layout: "
                "choose one of these"
            )
        return self.controls[control]

    def control_indices(self, control: str) -> np.ndarray:
        """Indices into the dual action vector of what ``control`` executes, in the order it expects them."""
        slices = self.action_slices
        width = sum(len(dimensions) for dimensions in self.action.values())
        return np.concatenate([np.arange(width)[slices[group]] for group in self.control_groups(control)])

    def action_space(self, control: str) -> gym.spaces.Box:
        """The environment's action space under ``control``."""
        return _box([d for group in self.control_groups(control) for d in self.action[group]])

    def observation_space(self) -> gym.spaces.Dict:
        """The state-only observation space (``agent_pos`` and ``environment_state``)."""
        return gym.spaces.Dict({"agent_pos": _box(self.agent_pos), "environment_state": _box(self.environment_state)})

    def dataset_features(self) -> dict[str, dict]:
        """LeRobotDataset features of the demonstrations (the dual action vector and the label columns)."""
        features: dict[str, dict] = {}
        for key, names in (
            ("observation.state", [d.name for d in self.agent_pos]),
            ("observation.environment_state", [d.name for d in self.environment_state]),
            ("action", self.action_names),
        ):
            features[key] = {"dtype": "float32", "shape": (len(names),), "names": names}
        for key in ("mode", "pair", "branch_step"):
            features[key] = {"dtype": "int64", "shape": (1,), "names": None}
        return features

    def table(self, dimensions: Sequence[Dimension]) -> str:
        """A Markdown table of ``dimensions`` for docstrings: index, name, unit, minimum, maximum, meaning."""
        rows = ["| index | name | unit | min | max | meaning |", "| --- | --- | --- | --- | --- | --- |"]
        rows += [
            f"| {i} | {d.name} | {d.unit} | {d.low:g} | {d.high:g} | {d.meaning} |" for i, d in enumerate(dimensions)
        ]
        return "\n".join(rows)


def _box(dimensions: Sequence[Dimension]) -> gym.spaces.Box:
    low = np.array([d.low for d in dimensions], dtype=np.float32)
    high = np.array([d.high for d in dimensions], dtype=np.float32)
    return gym.spaces.Box(low, high, dtype=np.float32)
