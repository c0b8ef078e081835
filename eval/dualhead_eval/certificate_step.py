"""The coordination certificate as a LeRobot processor step: labels or positions in, a verdict in ``info``.

    pipeline = PolicyProcessorPipeline(steps=[CoordinationCertificateStep(n_modes=2)])
    pipeline({"info": {"first": labels_a, "second": labels_b}})["info"]["coordination"]["verdict"]

Nothing of that needs an environment or a policy of this package. In the preprocessor of a dual-head policy, where it
sees the raw observation, it draws pairs of its own at every decision (``draws``), so that unmodified ``lerobot-eval``
comes to a verdict: ``dualhead certify``. The step and what it has counted are saved as JSON in the pipeline's own
configuration; LeRobot finds it by name.
"""

from __future__ import annotations

import logging
import weakref
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from lerobot.configs import PipelineFeatureType, PolicyFeature
from lerobot.processor import ProcessorStep, ProcessorStepRegistry, TransitionKey
from lerobot.utils.constants import OBS_ENV_STATE
from torch import Tensor

from dualhead_envs.dataset_sidecar import EnvironmentId
from dualhead_envs.recorded_environment import make_recorded
from dualhead_envs.validated_json import Label, Schema, validated
from dualhead_eval.certificate.certificate import CoordinationCertificate
from dualhead_eval.effects.sites import readable_valid_rate
from dualhead_eval.partitions.partition_file import build_partition
from dualhead_policy.decision_hooks import LISTENERS
from dualhead_policy.processor_loading import CERTIFICATE_NAME

#: The key in ``info`` under which a step reports.
REPORT = "coordination"
logger = logging.getLogger(__name__)


class StepEnvironment(Schema):
    """One of our environments, whose partition labels the paths."""

    env_id: EnvironmentId
    env_kwargs: dict[Label, Any]


@ProcessorStepRegistry.register(CERTIFICATE_NAME)
class CoordinationCertificateStep(ProcessorStep):
    """Feeds a certificate with what two heads, draws or policies chose, and reports what it says.

    A transition whose ``info`` holds both keys is a decision; others pass with the last report. Whole numbers are
    labels, (n,) pairs of one decision or (B, n) of B decisions side by side, -1 invalid; other numbers are positions
    (n, H, d) or (B, n, H, d), which takes a partition. Pairs must be independent draws of their decision.

    With ``draws``, every decision of a dual-head policy that follows a transition is one, too: the step draws that many
    pairs with random numbers of its own, which leaves what the policy executes as it is, and never those of the pair
    that is executed, which may follow a token of the episode. Rows of a batch whose episode is over go on being counted
    until the last one's is. The log says what the certificate says whenever its verdict changes, the decisions have
    doubled, or the step is no longer used.

    Args:
        n_modes: Number of modes K; with a partition its own.
        partition: A partition that needs no code, as its ``to_dict`` or a partition file describes it.
        first: Key of the first of the two in ``info``.
        second: Key of the second.
        alpha: Probability that any bound ever fails.
        state: What an earlier step has counted, as :meth:`get_config` gives it, with the alpha that it counted for.
        environment: One of our environments, ``env_id`` and ``env_kwargs``, whose partition is used instead; paths
            are labelled under the observation's ``observation.environment_state``.
        draws: Pairs to draw at every decision of a dual-head policy in this process; 0 draws none.
        seed: Seed of these draws.

    Attributes:
        certificate: The certificate; it keeps what it has seen through episodes.

    Raises:
        ValueError: If the partition, the environment or the state is none, or K is not the same everywhere.
    """

    def __init__(
        self,
        n_modes: int | None = None,
        partition: Mapping[str, Any] | None = None,
        first: str = "first",
        second: str = "second",
        alpha: float = 0.05,
        state: Mapping[str, Any] | None = None,
        environment: Mapping[str, Any] | None = None,
        draws: int = 0,
        seed: int = 0,
    ) -> None:
        self.first, self.second, self.draws, self.seed = first, second, draws, seed
        self._described = None if partition is None else dict(partition)
        self._environment = None if environment is None else dict(environment)
        self._partition = self._opened_partition()
        given = n_modes if self._partition is None else self._partition.n_modes
        if given is None or n_modes not in (None, given):
            raise ValueError(
                f"n_modes={n_modes} and a partition of {given} modes, expected one number of modes: leave n_modes out, "
                "or give it where there is no partition"
            )
        if draws and (self._partition is None or draws < 2):
            raise ValueError(
                f"draws={draws} without a partition or of one pair, expected 2 pairs or more and a partition, which "
                "labels them: give both, or leave draws out"
            )
        name = "" if self._partition is None else self._partition.to_dict()["name"]
        self.certificate = CoordinationCertificate(given, alpha, min_valid_rate=readable_valid_rate(name))
        if state is not None:
            self.certificate = CoordinationCertificate.from_dict(state)
            if self.certificate.n_modes != given:
                raise ValueError(
                    f"the state counts {self.certificate.n_modes} modes, the step {given}, expected the same: start "
                    "without the state"
                )
        self._condition: np.ndarray | None = None
        self._is_due = self._has_drawn = False
        self._logged: tuple[str, int] = ("", 0)
        if draws:
            LISTENERS.add(self)
            weakref.finalize(self, _log, self.certificate)

    def _opened_partition(self) -> Any:
        """The partition that labels paths; None where labels are given."""
        if self._environment is None:
            return None if self._described is None else build_partition(self._described)
        if self._described is not None:
            raise ValueError("a partition and an environment were given, expected one of the two: leave one out")
        source = "environment"
        own = validated(self._environment, StepEnvironment, source=source, remedy="name one of dualhead_envs")
        env = make_recorded(own.env_id, own.env_kwargs, source)
        partition = env.unwrapped.mode_partition  # type: ignore[attr-defined]
        env.close()
        return partition

    def __call__(self, transition: Any) -> Any:
        """Count a decision if there is one; adds the report to ``info``.

        Raises:
            ValueError: If one of the two is missing, positions come without a partition, or shapes do not fit.
        """
        self._current_transition = transition
        self._condition = self._observed_condition(transition)
        self._is_due = True
        info = dict(transition.get(TransitionKey.INFO) or {})
        given = [key in info for key in (self.first, self.second)]
        if any(given):
            if not all(given):
                raise ValueError(
                    f"info holds {self.first if given[0] else self.second!r} alone, expected both {self.first!r} and "
                    f"{self.second!r}: give a decision's labels or positions of both"
                )
            labels = [self._labels(info[key], key) for key in (self.first, self.second)]
            self.certificate.update(*labels)
        changed = transition.copy()
        changed[TransitionKey.INFO] = info | {REPORT: self.report(decided=all(given) or self._has_drawn)}
        self._has_drawn = False
        return changed

    def _observed_condition(self, transition: Any) -> np.ndarray | None:
        """The condition (B, C) that the environment's partition labels under; None where it needs none."""
        if self._environment is None:
            return None
        observed = (transition.get(TransitionKey.OBSERVATION) or {}).get(OBS_ENV_STATE)
        if observed is None:
            raise ValueError(
                f"the observation has no {OBS_ENV_STATE}, under which the partition of {self._environment['env_id']} "
                "labels paths: put the step before what takes it away, or give a partition that needs no condition"
            )
        return torch.as_tensor(observed).detach().cpu().double().numpy()

    def decided(self, policy: Any, batch: Mapping[str, Tensor]) -> None:
        """Draw pairs of a decision that a policy makes after this step's transition, and count them."""
        if not self._is_due:  # another policy's
            return
        self._is_due, self._has_drawn = False, True
        spent = np.random.SeedSequence([self.seed, self.certificate.reading.decisions]).generate_state(1, np.uint64)
        generator = torch.Generator().manual_seed(int(spent[0] >> np.uint64(1)))
        samples = policy.sample(batch, self.draws, generator=generator)
        paths = (policy.model.kinematics.position(samples.joint.double()), samples.position.double())
        labels = [self._assign(path.cpu().numpy()) for path in paths]
        self.certificate.update(*labels)
        reading = self.certificate.reading
        if reading.verdict != self._logged[0] or reading.decisions >= 2 * self._logged[1]:
            self._logged = (reading.verdict, reading.decisions)
            _log(self.certificate)

    def _assign(self, path: np.ndarray) -> np.ndarray:
        """Labels (...) of paths (..., H, d), whose first axis is that of the observed conditions."""
        assert self._partition is not None
        if self._condition is None:
            return self._partition.assign(path)
        return self._partition.assign(path, self._condition[:, None] if path.ndim == 4 else self._condition)

    def _labels(self, values: Any, key: str) -> np.ndarray:
        """Labels (B, n) of what ``info`` holds."""
        array = np.asarray(values)
        if array.dtype.kind not in "iu":
            if self._partition is None:
                raise ValueError(
                    f"info[{key!r}] holds {array.dtype} numbers, expected whole ones (labels): give the step a "
                    "partition, which labels positions"
                )
            array = self._assign(array)
        return array[None] if array.ndim == 1 else array

    def report(self, *, decided: bool) -> dict[str, Any]:
        """What ``info`` says: verdict, why it is not a firmer one, estimates, and whether this was a decision."""
        return self.certificate.reading.summary() | {"decision": decided}

    def get_config(self) -> dict[str, Any]:
        """The constructor's arguments, with what has been counted so far."""
        return {
            "n_modes": self.certificate.n_modes,
            "partition": self._described,
            "first": self.first,
            "second": self.second,
            "state": self.certificate.to_dict(),
            "environment": self._environment,
            "draws": self.draws,
            "seed": self.seed,
        }

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Changes no feature."""
        return features


def _log(certificate: CoordinationCertificate) -> None:
    """Say what a certificate says, once it has counted anything."""
    reading = certificate.reading
    if not reading.decisions:
        return
    rho = reading.bounds["rho"]
    logger.info(
        "coordination certificate: %d decisions, valid %.2f, rho %+.2f [%+.2f, %+.2f]: %s%s",
        reading.decisions, reading.valid_rate, reading.rho, rho.low, rho.high, reading.verdict,
        f" ({reading.reason})" if reading.reason else "",
    )  # fmt: skip
