"""Two draws of one head, or one draw of each of two policies, as the pair that is evaluated.

Any policy that predicts a chunk of actions can be drawn from, LeRobot's other types among them. Its paths are those of
the end effector: by default the ``position.*`` dimensions of the action as predicted, or the ``joint.*`` dimensions
through forward kinematics. Two draws are independent: each has seeds, noise and a queue of its own. What the gate's
capacity then says is how many ways the policy keeps open; its effect is that of independent draws.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
import torch

from dualhead_eval.evaluation.conditions import ConditionBank
from dualhead_eval.evaluation.labelled_pairs import LabelledPairs
from dualhead_eval.evaluation.protocol import EvaluationProtocol
from dualhead_eval.evaluation.samplers import EvaluatedSampler, open_policy
from dualhead_eval.gate.gate import DRAWS, POLICY_PAIR
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.lerobot_policies.chunks import ChunkPolicy
from dualhead_policy.pretrained import policy_folder
from dualhead_policy.sampling import SamplingCoupling

Head = Literal["position", "joint"]
#: What the two draws of one head are called.
DRAW_NAMES = ("draw 1", "draw 2")


class PathSource(Protocol):
    """One policy, from which paths are drawn."""

    @property
    def provenance(self) -> dict[str, Any]:
        """Configuration, checkpoint and training of the policy."""
        ...

    @property
    def default_nfe(self) -> int:
        """Denoising or integration steps of a sample, as the policy was configured."""
        ...

    def require_conditions(self, conditions: ConditionBank) -> None:
        """Refuse conditions that do not fit."""
        ...

    def paths(self, conditions: ConditionBank, draws: int, nfe: int, seed: int) -> np.ndarray:
        """Paths (B, draws, H, d) under B conditions, a function of the seed."""
        ...


@dataclass(frozen=True)
class LerobotPaths:
    """Paths of a policy of LeRobot's other types.

    Attributes:
        policy: The policy.
        head: Which dimensions of its action are the path.
        provenance: What a gate says of it.
    """

    policy: ChunkPolicy
    head: Head
    provenance: dict[str, Any]

    @property
    def default_nfe(self) -> int:
        """Denoising steps as configured."""
        return self.policy.denoising_steps

    def require_conditions(self, conditions: ConditionBank) -> None:
        """Refuse conditions that lack what the policy observes, or whose action has other dimensions.

        Raises:
            ValueError: In one sentence about the first difference.
        """
        history = conditions.history(self.policy.n_obs_steps)
        for key, shape in self.policy.observation_shapes.items():
            if key not in history:
                raise ValueError(
                    f"the policy observes {key}, which the conditions lack (they have {sorted(history)}): evaluate a "
                    "policy of these observations"
                )
            if history[key].shape[2:] != shape:
                raise ValueError(
                    f"the policy observes {key} of shape {list(shape)}, the conditions have "
                    f"{list(history[key].shape[2:])}: evaluate on the environment that the policy was trained on"
                )
        if self.policy.action_width != len(conditions.action_names):
            raise ValueError(
                f"the policy's actions have {self.policy.action_width} dimensions, the dataset's "
                f"{len(conditions.action_names)}: evaluate on a dataset of the kind that the policy was trained on"
            )
        _path_columns(self.head, conditions)

    def paths(self, conditions: ConditionBank, draws: int, nfe: int, seed: int) -> np.ndarray:
        """Paths (B, draws, H, d) of the window in which a mode is told.

        Raises:
            ValueError: If the policy's chunk is shorter than the window, or holds a number that is not finite.
        """
        self.policy.use_denoising_steps(nfe)
        history = conditions.history(self.policy.n_obs_steps)
        raw = {key: torch.from_numpy(history[key]) for key in self.policy.observation_shapes}
        chunk = self.policy.draw(raw, draws, seed).double()
        if chunk.shape[2] < conditions.horizon:
            raise ValueError(
                f"the policy predicts {chunk.shape[2]} steps from the present one, modes are told in "
                f"{conditions.horizon}: evaluate a policy of longer chunks"
            )
        if not torch.isfinite(chunk).all():
            raise ValueError("the policy predicted a number that is not finite, expected actions: train it further")
        part = chunk[:, :, : conditions.horizon, _path_columns(self.head, conditions)]
        return _positions(part, self.head, conditions)


@dataclass(frozen=True)
class HeadPaths:
    """Paths of one head of a dual-head policy.

    Attributes:
        sampler: The policy.
        head: The head.
    """

    sampler: EvaluatedSampler
    head: Head

    @property
    def provenance(self) -> dict[str, Any]:
        """What a gate says of the policy."""
        return {key: value for key, value in self.sampler.provenance.items() if key != "method"}

    @property
    def default_nfe(self) -> int:
        """The frozen protocol's Euler steps."""
        return self.sampler.default_nfe

    def require_conditions(self, conditions: ConditionBank) -> None:
        """Refuse conditions of another layout."""
        self.sampler.require_conditions(conditions)

    def paths(self, conditions: ConditionBank, draws: int, nfe: int, seed: int) -> np.ndarray:
        """Paths (B, draws, H, d): every draw has noise, token and latent of its own."""
        samples = self.sampler.sample(conditions, draws, nfe, SamplingCoupling(), seed)
        values = (samples.joint if self.head == "joint" else samples.position).double()
        return (self.sampler.kinematics.position(values) if self.head == "joint" else values).cpu().numpy()


class PolicyDraws:
    """Pairs of independent draws: of one policy, or one of each of two.

    Args:
        first: Where the first of a pair comes from.
        second: Where the second does; by default from the same policy.
        names: What the two are called.
        own_steps: Whether each policy takes its own number of steps, whatever the protocol's.
    """

    def __init__(
        self,
        first: PathSource,
        second: PathSource | None = None,
        *,
        names: tuple[str, str] = DRAW_NAMES,
        own_steps: bool = False,
    ) -> None:
        self.sources = (first, first if second is None else second)
        self.names, self.own_steps = names, own_steps
        self._deterministic: tuple[bool, ...] = (False, False)

    @property
    def default_nfe(self) -> int:
        """The first policy's steps."""
        return self.sources[0].default_nfe

    @property
    def deterministic(self) -> bool:
        """Whether a policy always predicts the same under one condition; known once conditions were required."""
        return any(self._deterministic)

    @cached_property
    def _alike(self) -> bool:
        return self.sources[0] is self.sources[1]

    @property
    def provenance(self) -> dict[str, Any]:
        """One policy's provenance, or both in a list."""
        told = [
            {**source.provenance, "deterministic": same}
            for source, same in zip(self.sources, self._deterministic, strict=True)
        ]
        head = getattr(self.sources[0], "head", "position")
        if self._alike:
            return {"method": DRAWS, "head": head, **told[0]}
        return {"method": POLICY_PAIR, "head": head, "policies": told}

    def require_conditions(self, conditions: ConditionBank) -> None:
        """Refuse conditions that do not fit, and find out which policy is deterministic.

        Raises:
            ValueError: If a policy does not fit the conditions.
        """
        for source in self.sources:
            source.require_conditions(conditions)
        few = conditions[: min(2, len(conditions))]
        self._deterministic = tuple(_repeats(source, few) for source in self.sources)

    def label_pairs(
        self, conditions: ConditionBank, protocol: EvaluationProtocol, nfe: int, group: int
    ) -> LabelledPairs:
        """The protocol's pairs under one group of conditions; a deterministic policy's chunk is predicted once."""
        paths = []
        seeds = protocol.group_seeds(nfe, group, 2)
        for source, same, seed in zip(self.sources, self._deterministic, seeds, strict=True):
            steps = source.default_nfe if self.own_steps else nfe
            drawn = source.paths(conditions, 1 if same else protocol.pairs, steps, seed)
            paths.append(np.repeat(drawn, protocol.pairs, axis=1) if same else drawn)
        return LabelledPairs.from_paths(
            paths[0],
            paths[1],
            conditions.state,
            conditions.partition,
            conditions.direction,
            heads=self.names,
            metres=conditions.metres,
        )


def open_paths(path: str | Path, head: Head) -> PathSource:
    """A policy to draw from, by its folder, its training run's output folder, or its name on the hub.

    Raises:
        FileNotFoundError: If there is no policy.
        ValueError: If it is damaged, or of a type that is not opened.
    """
    from dualhead_policy.lerobot_policies.configuration_loading import read_policy_type
    from dualhead_policy.lerobot_policies.opening import open_lerobot_policy
    from dualhead_policy.training.provenance import lerobot_provenance

    folder = policy_folder(path)
    if read_policy_type(folder) == "dualhead":
        return HeadPaths(open_policy(folder), head)
    policy = open_lerobot_policy(folder)
    return LerobotPaths(policy, head, lerobot_provenance(policy.policy.config, folder))


def _repeats(source: PathSource, conditions: ConditionBank) -> bool:
    """Whether draws with different seeds are the same, bit for bit."""
    first, second = (source.paths(conditions, 2, source.default_nfe, seed) for seed in (1, 2))
    return np.array_equal(first, second)


def _path_columns(head: Head, conditions: ConditionBank) -> list[int]:
    columns = [i for i, name in enumerate(conditions.action_names) if name.split(".")[0] == head]
    if conditions.path_names:
        columns = [conditions.action_names.index(name) for name in conditions.path_names]
    if not columns:
        raise ValueError(
            f"the dataset's action has no dimensions {head}.* (it has {_few(conditions.action_names)}): say which are "
            "the path with --path-names"
        )
    return columns


def _positions(values: torch.Tensor, head: Head, conditions: ConditionBank) -> np.ndarray:
    if head == "joint":
        values = KinematicMap(conditions.kinematic_map).position(values)
    return values.cpu().numpy()


def _few(names: tuple[str, ...]) -> str:
    return ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
