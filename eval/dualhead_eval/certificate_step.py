"""The coordination certificate as a LeRobot processor step: labels or positions in, a verdict in ``info``.

    pipeline = PolicyProcessorPipeline(steps=[CoordinationCertificateStep(n_modes=2)])
    pipeline({"info": {"first": labels_a, "second": labels_b}})["info"]["coordination"]["verdict"]

Nothing of it needs an environment or a policy of this package. The step and what it has counted are saved as JSON in
the pipeline's own configuration; importing this module registers it, so that a saved pipeline loads by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from lerobot.configs import PipelineFeatureType, PolicyFeature
from lerobot.processor import ProcessorStep, ProcessorStepRegistry, TransitionKey

from dualhead_eval.certificate.certificate import CoordinationCertificate
from dualhead_eval.partitions.partition_file import build_partition

REGISTRY_NAME = "coordination_certificate"
#: The key in ``info`` under which a step reports.
REPORT = "coordination"


@ProcessorStepRegistry.register(REGISTRY_NAME)
class CoordinationCertificateStep(ProcessorStep):
    """Feeds a certificate with what two heads, draws or policies chose, and reports what it says.

    A transition whose ``info`` holds both keys is a decision; others pass with the last report. Whole numbers are
    labels, (n,) pairs of one decision or (B, n) of B decisions side by side, -1 invalid; other numbers are positions
    (n, H, d) or (B, n, H, d), which takes a partition. Pairs must be independent draws of their decision.

    Args:
        n_modes: Number of modes K; with a partition its own.
        partition: A partition that needs no code, as its ``to_dict`` or a partition file describes it.
        first: Key of the first of the two in ``info``.
        second: Key of the second.
        alpha: Probability that any bound ever fails.
        state: What an earlier step has counted, as :meth:`get_config` gives it, with the alpha that it counted for.

    Attributes:
        certificate: The certificate; it keeps what it has seen through episodes.

    Raises:
        ValueError: If the partition or the state is none, or K is not the same everywhere.
    """

    def __init__(
        self,
        n_modes: int | None = None,
        partition: Mapping[str, Any] | None = None,
        first: str = "first",
        second: str = "second",
        alpha: float = 0.05,
        state: Mapping[str, Any] | None = None,
    ) -> None:
        self.first, self.second = first, second
        self._described = None if partition is None else dict(partition)
        self._partition = None if partition is None else build_partition(dict(partition))
        given = n_modes if self._partition is None else self._partition.n_modes
        if given is None or n_modes not in (None, given):
            raise ValueError(
                f"n_modes={n_modes} and a partition of {given} modes, expected one number of modes: leave n_modes out, "
                "or give it where there is no partition"
            )
        self.certificate = CoordinationCertificate(given, alpha)
        if state is not None:
            self.certificate = CoordinationCertificate.from_dict(state)
            if self.certificate.n_modes != given:
                raise ValueError(
                    f"the state counts {self.certificate.n_modes} modes, the step {given}, expected the same: start "
                    "without the state"
                )

    def __call__(self, transition: Any) -> Any:
        """Count a decision if there is one; adds the report to ``info``.

        Raises:
            ValueError: If one of the two is missing, positions come without a partition, or shapes do not fit.
        """
        self._current_transition = transition
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
        changed[TransitionKey.INFO] = info | {REPORT: self.report(decided=all(given))}
        return changed

    def _labels(self, values: Any, key: str) -> np.ndarray:
        """Labels (B, n) of what ``info`` holds."""
        array = np.asarray(values)
        if array.dtype.kind not in "iu":
            if self._partition is None:
                raise ValueError(
                    f"info[{key!r}] holds {array.dtype} numbers, expected whole ones (labels): give the step a "
                    "partition, which labels positions"
                )
            array = self._partition.assign(array)
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
        }

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Changes no feature."""
        return features
