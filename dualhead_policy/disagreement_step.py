"""A processor step that watches both decodings of every executed action and raises an alarm when they part.

It stands in a policy's postprocessor, where the dual action still holds joint targets and positions, so that it works
in unmodified LeRobot: ``lerobot-eval`` runs it before the environment takes its part of the action. The score of a
decision is the mean distance, in mm, of the decoded joint targets from the positions over the steps that were executed;
it is known when the last of them is. Alarms are log lines, one an episode, and entries of ``alarms``.
"""

from __future__ import annotations

import logging
from typing import Any
from weakref import WeakSet

import torch
from lerobot.configs import PipelineFeatureType, PolicyFeature
from lerobot.processor import PolicyActionProcessorStep, ProcessorStepRegistry
from torch import Tensor

from dualhead_policy.kinematics.kinematic_map import KinematicMap

REGISTRY_NAME = "disagreement_monitor"
#: Steps of this process: LeRobot resets the policy at the beginning of an episode, and no processor.
_STEPS: WeakSet[DisagreementMonitorStep] = WeakSet()


@ProcessorStepRegistry.register(REGISTRY_NAME)
class DisagreementMonitorStep(PolicyActionProcessorStep):
    """Compares the largest exponentially weighted mean of the decisions' scores so far with a limit.

    Rows of a batch are environments side by side; one that has ended goes on until the last has, as in lerobot-eval.
    With several dual-head policies in one process, every policy's reset begins an episode here.

    Args:
        kinematic_map: Name of the map from head A's space to the position.
        joint: First dimension of head A's part of the dual action, and the one after its last.
        position: The same of head B's part, in m.
        decision_steps: Control steps between decisions, the policy's ``n_action_steps``.
        weight: Weight of the newest score.
        limit_mm: The limit in mm.

    Attributes:
        alarms: Row, control step, aggregate and limit of every alarm so far, and the episode's number.
    """

    def __init__(
        self,
        kinematic_map: str,
        joint: tuple[int, int],
        position: tuple[int, int],
        decision_steps: int,
        weight: float,
        limit_mm: float,
    ) -> None:
        self.kinematic_map, self.joint, self.position = kinematic_map, tuple(joint), tuple(position)
        self.decision_steps, self.weight, self.limit_mm = decision_steps, weight, limit_mm
        self.alarms: list[dict[str, Any]] = []
        self._map = KinematicMap(kinematic_map)
        self._episode = -1
        self.reset()
        _STEPS.add(self)

    def reset(self) -> None:
        """Begin an episode in every row."""
        self._step = 0
        self._distances: list[Tensor] = []
        self._average = self._largest = torch.empty(0)
        self._alarmed = torch.empty(0, dtype=torch.bool)

    def action(self, action: Tensor) -> Tensor:
        """Watch a dual action (B, D); returns it as it is."""
        if self._step == 0:
            self._episode += 1
        if len(self._alarmed) != len(action):
            self._average = torch.full((len(action),), torch.nan, dtype=torch.float64)
            self._largest = torch.full((len(action),), -torch.inf, dtype=torch.float64)
            self._alarmed = torch.zeros(len(action), dtype=torch.bool)
        dual = action.detach().double().cpu()
        decoded = self._map.position(dual[:, slice(*self.joint)])
        self._distances.append(1000.0 * (decoded - dual[:, slice(*self.position)]).norm(dim=-1))
        self._step += 1
        if len(self._distances) == self.decision_steps:
            self._decide(torch.stack(self._distances).mean(dim=0))
            self._distances = []
        return action

    def _decide(self, score: Tensor) -> None:
        score = score.nan_to_num(torch.inf)  # a diverged decision ranks above all others
        averaged = (1 - self.weight) * self._average + self.weight * score
        self._average = torch.where(self._average.isnan(), score, averaged)
        self._largest = torch.maximum(self._largest, self._average)
        for row in torch.nonzero((self._largest > self.limit_mm) & ~self._alarmed).flatten().tolist():
            self._alarmed[row] = True
            found = {
                "episode": self._episode,
                "row": row,
                "step": self._step,
                "aggregate_mm": float(self._largest[row]),
            }
            self.alarms.append(found | {"limit_mm": self.limit_mm})
            logging.getLogger(__name__).warning(
                "disagreement alarm: episode %d, row %d, step %d: %.1f mm exceeds %.1f mm",
                self._episode, row, self._step, found["aggregate_mm"], self.limit_mm,
            )  # fmt: skip

    def get_config(self) -> dict[str, Any]:
        """The constructor's arguments, as JSON keeps them."""
        return {
            "kinematic_map": self.kinematic_map,
            "joint": list(self.joint),
            "position": list(self.position),
            "decision_steps": self.decision_steps,
            "weight": self.weight,
            "limit_mm": self.limit_mm,
        }

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Changes no feature."""
        return features


def begin_episodes() -> None:
    """Let every step of this process begin an episode; a policy's reset calls this."""
    for step in list(_STEPS):
        step.reset()
