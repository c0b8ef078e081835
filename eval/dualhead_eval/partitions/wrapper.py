"""A Gymnasium wrapper that gives any environment a mode partition."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from dualhead_eval.partitions.partition import Partition
from dualhead_eval.partitions.scored import ScoredPartition


class ModePartitionWrapper(gym.Wrapper, gym.utils.RecordConstructorArgs):
    """Labels the path since the last reset and writes the label into ``info["mode"]``, -1 while it is undecided.

    The wrapped environment is left as it is; wrappers outside of this one, such as
    :class:`dualhead_eval.certificate.wrapper.CertificateWrapper`, find ``mode_partition`` and ``mode_condition`` here.

    Args:
        env: The environment.
        partition: Anything with ``assign``, ``n_modes``, ``tau`` and ``to_dict``.
        position: The point (d,) of a path at an observation, in the partition's unit.
        condition: The condition (C,) of an observation; by default its ``environment_state``, or nothing.

    Raises:
        ValueError: If ``partition`` is none.
    """

    def __init__(
        self,
        env: gym.Env,
        partition: Partition,
        position: Callable[[Any], Any],
        condition: Callable[[Any], Any] | None = None,
    ) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, partition=partition, position=position, condition=condition)
        gym.Wrapper.__init__(self, env)
        self.mode_partition = ScoredPartition(partition)
        self._position, self._condition = position, condition
        self._path: list[np.ndarray] = []

    def mode_condition(self, observation: Any) -> np.ndarray:
        """The condition (C,) of an observation."""
        if self._condition is not None:
            return np.asarray(self._condition(observation), dtype=np.float64)
        if isinstance(observation, Mapping) and "environment_state" in observation:
            return np.asarray(observation["environment_state"], dtype=np.float64)
        return np.zeros(0)

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and begin a path."""
        observation, info = super().reset(**kwargs)
        self._start = self.mode_condition(observation)
        self._path = []
        return observation, info | {"mode": self._mode(observation)}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment and label the path so far, under the condition of the reset."""
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, reward, terminated, truncated, info | {"mode": self._mode(observation)}

    def _mode(self, observation: Any) -> int:
        point = np.asarray(self._position(observation), dtype=np.float64)
        if point.ndim != 1 or not np.isfinite(point).all():
            raise ValueError(
                f"position gives {point!r}, expected a finite point (d,): take it from the observation as the "
                "partition expects it"
            )
        self._path.append(point)
        return int(self.mode_partition.assign(np.stack(self._path), self._start))
