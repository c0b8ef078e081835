"""A Gymnasium wrapper that runs a coordination certificate beside a rollout.

Every few steps a policy decides: it samples both heads for the current observation. The wrapper labels those
samples with the environment's mode partition, feeds the certificate, and writes the cross-head residual
and the verdict into ``info["coordination"]`` of every reset and step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike

from dualhead_eval.certificate.certificate import CoordinationCertificate
from dualhead_eval.certificate.decision_wrapper import DecisionWrapper
from dualhead_eval.certificate.reading import VERDICTS
from dualhead_eval.effects.sites import readable_valid_rate
from dualhead_eval.residuals.distances import position_residual_mm

#: Both heads' samples for one observation, as positions in metres: two arrays ``(n, H, d)``.
Predictions = tuple[ArrayLike, ArrayLike]

#: Columns that :func:`certificate_columns` adds to a recorded LeRobotDataset.
CERTIFICATE_FEATURES: dict[str, dict[str, Any]] = {
    "certificate.residual_mm": {"dtype": "float32", "shape": (1,), "names": None},
    "certificate.verdict": {"dtype": "int64", "shape": (1,), "names": None},
    "certificate.delta": {"dtype": "float32", "shape": (1,), "names": None},
    "certificate.capacity": {"dtype": "float32", "shape": (1,), "names": None},
}


class CertificateWrapper(DecisionWrapper):
    """Attach a certificate to one environment.

    ``info["coordination"]`` holds ``verdict``, ``reason`` (why it is not a firmer one), ``kind``, ``delta``,
    ``capacity``, ``valid_rate``, ``decisions``, ``decision`` (whether this step made one) and ``residual_mm``, the
    mean residual of the last decision's pairs.

    Args:
        env: An environment of ours, or any in a
            :class:`~dualhead_eval.partitions.wrapper.ModePartitionWrapper`.
        predict: Samples of both heads for an observation, as positions in metres ``(n, H, d)``; sample i of
            one head is paired with sample i of the other, as the policy couples them.
        certificate: The certificate to feed, shared among environments if wanted; a new one by default.
        decision_interval: Steps between decisions (the policy's ``n_action_steps``).
        held_pairs: How many of the first pairs follow a token or latent held from earlier decisions, as the executed
            one does in closed loop. They are no independent draws: the residual counts them, the certificate must not.

    Raises:
        ValueError: If the environment has no mode partition, or the certificate another number of modes.
    """

    key = "coordination"

    def __init__(
        self,
        env: gym.Env,
        predict: Callable[[Any], Predictions],
        certificate: CoordinationCertificate | None = None,
        *,
        decision_interval: int = 8,
        held_pairs: int = 0,
    ) -> None:
        super().__init__(env, decision_interval)
        if not env.has_wrapper_attr("mode_partition"):
            raise ValueError(
                f"{env.unwrapped!r} has no mode_partition, expected an environment of dualhead_envs or one in a "
                "ModePartitionWrapper: give it a partition"
            )
        partition = env.get_wrapper_attr("mode_partition")
        if held_pairs < 0:
            raise ValueError(f"held_pairs={held_pairs}, expected 0 or a number of pairs")
        self.certificate = certificate or CoordinationCertificate(
            n_modes=partition.n_modes, min_valid_rate=readable_valid_rate(partition.to_dict()["name"])
        )
        if self.certificate.n_modes != partition.n_modes:
            raise ValueError(
                f"certificate counts {self.certificate.n_modes} modes and the environment has "
                f"{partition.n_modes}, expected the same: build the certificate with the environment's number"
            )
        self._partition = partition
        given = env.has_wrapper_attr("mode_condition")
        self._condition = env.get_wrapper_attr("mode_condition") if given else _environment_state
        self._predict = predict
        self._held = held_pairs
        self._residual = float("nan")

    def decide(self, observation: Any, step: int) -> None:
        """Sample both heads, label the paths, feed the certificate, which keeps what it has seen through resets."""
        path_a, path_b = (np.asarray(path, dtype=np.float64) for path in self._predict(observation))
        if path_a.ndim != 3 or path_a.shape != path_b.shape:
            raise ValueError(
                f"predictions have shapes {path_a.shape} and {path_b.shape}, expected (n, H, d) positions in metres"
            )
        if len(path_a) <= self._held:
            raise ValueError(
                f"{len(path_a)} pairs predicted of which {self._held} follow what the episode holds, expected "
                "fresh pairs too: sample more pairs per decision"
            )
        condition = np.asarray(self._condition(observation), dtype=np.float64)
        labels = (self._partition.assign(path[self._held :], condition) for path in (path_a, path_b))
        self.certificate.update(*(label[None] for label in labels))
        self._residual = float(position_residual_mm(path_a, path_b).mean())

    def report(self, *, decided: bool) -> dict[str, Any]:
        """Verdict, estimates and the last decision's residual."""
        reading = self.certificate.reading
        own = {"kind": reading.kind, "decision": decided, "residual_mm": self._residual}
        return reading.summary() | own


def _environment_state(observation: Mapping[str, Any]) -> ArrayLike:
    """The condition of our environments' observations."""
    return observation["environment_state"]


def certificate_columns(info: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """One frame's values of :data:`CERTIFICATE_FEATURES` from ``info["coordination"]``.

    The verdict is stored as its index in :data:`dualhead_eval.certificate.reading.VERDICTS`.
    """
    report = info["coordination"]
    columns = {
        f"certificate.{key}": np.array([report[key]], dtype=np.float32) for key in ("residual_mm", "delta", "capacity")
    }
    columns["certificate.verdict"] = np.array([VERDICTS.index(report["verdict"])])
    return columns
