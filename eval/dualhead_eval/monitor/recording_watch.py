"""A fitted monitor beside episodes that are recorded: its readings become columns of the rollout dataset."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from dualhead_eval.evaluation.decisions import OBSERVATIONS, Decider
from dualhead_eval.monitor.branch_flag import BranchFlag
from dualhead_eval.monitor.decision import Decision
from dualhead_eval.monitor.decision_builder import DecisionBuilder
from dualhead_eval.monitor.monitor import Monitor
from dualhead_eval.monitor.wrapper import MonitorWrapper

#: Columns by the reading's field, with their type.
_FIELDS = {"score": np.float32, "aggregate": np.float32, "threshold": np.float32, "alarm": np.bool_}


class RecordedMonitor:
    """Reads every decision of a recording with a monitor.

    Args:
        monitor: A fitted monitor; its first signal gives the columns.
        layout: Name of the kinematic map.
        state_names: Names of the proprioception's dimensions.
        control: The head that drives.
        partition: The environment's mode partition.
        flag: Says of an observation whether two modes are open, for Mondrian thresholds.
    """

    def __init__(
        self, monitor: Monitor, layout: str, state_names: list[str], control: str, partition: Any,
        flag: BranchFlag | None = None,
    ) -> None:  # fmt: skip
        self.features: dict[str, dict[str, Any]] = {
            f"monitor.{name}": {"dtype": np.dtype(kind).name, "shape": (1,), "names": None}
            for name, kind in _FIELDS.items()
        }
        self._monitor = monitor
        self._builder = DecisionBuilder(layout, state_names, control, partition, flag)

    def wrap(self, env: gym.Env, decisions: Decider) -> gym.Env:
        """The environment with the monitor beside it; it reads what the inner wrapper made the policy decide."""

        def decide(observation: Mapping[str, Any], step: int) -> Decision:
            joint, position = (
                decisions.predictions[f"prediction.{head}"].reshape(decisions.samples, decisions.horizon, -1)
                for head in ("joint", "position")
            )
            state, context = (observation[key] for key in OBSERVATIONS)
            return self._builder.build(step, state, context, joint, position)

        return MonitorWrapper(env, decide, self._monitor, decision_interval=decisions.interval)

    def columns(self, info: Mapping[str, Any]) -> dict[str, np.ndarray]:
        """The last reading."""
        return {f"monitor.{name}": np.array([info["monitor"][name]], dtype=kind) for name, kind in _FIELDS.items()}
