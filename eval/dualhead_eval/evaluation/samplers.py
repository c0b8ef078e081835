"""What can be evaluated, opened by path: a policy's folder, or a reference of the conditions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from dualhead_eval.evaluation.conditions import ConditionBank
from dualhead_eval.evaluation.labelled_pairs import LabelledPairs
from dualhead_eval.evaluation.protocol import FROZEN_NFE, EvaluationProtocol
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.kinematics.rotation6d import columns_from_matrix
from dualhead_policy.representation import require_observations
from dualhead_policy.sampling import HeadSamples, Sampler, SamplingCoupling


@dataclass(frozen=True)
class EvaluatedSampler:
    """A sampler ready to be evaluated: what samples, what it takes and what a gate says of it.

    Attributes:
        sampler: A policy or the exact reference.
        preprocess: Turns raw observations by LeRobot key, each (B, dim), into what the sampler takes.
        kinematics: Its map from head A's space to the position.
        provenance: What a gate says of it.
        input_features: Shapes of the observations that it takes, where they are known.
    """

    sampler: Sampler
    preprocess: Callable[[Any], Mapping[str, Any]]
    kinematics: KinematicMap
    provenance: dict[str, Any]
    input_features: Mapping[str, Any] = field(default_factory=dict)

    def require_conditions(self, conditions: ConditionBank) -> None:
        """Refuse conditions of another layout.

        Raises:
            ValueError: If the kinematic map or the observations' widths differ.
        """
        if self.kinematics.name != conditions.kinematic_map:
            raise ValueError(
                f"the policy's layout is {self.kinematics.name!r}, the dataset's is {conditions.kinematic_map!r}: "
                "evaluate on a dataset of the layout that the policy was trained on"
            )
        widths = {key: value.shape[1] for key, value in conditions.observation.items()}
        require_observations(self.input_features, widths)

    def sample(
        self, conditions: ConditionBank, pairs: int, nfe: int, coupling: SamplingCoupling, seed: int
    ) -> HeadSamples:
        """Sample ``pairs`` chunks of every head under each condition, in ``nfe`` Euler steps."""
        raw = {key: torch.from_numpy(value) for key, value in conditions.observation.items()}
        generator = torch.Generator().manual_seed(seed)
        return self.sampler.sample(self.preprocess(raw), pairs, num_steps=nfe, coupling=coupling, generator=generator)

    @property
    def default_nfe(self) -> int:
        """The frozen protocol's Euler steps."""
        return FROZEN_NFE

    def label_pairs(
        self, conditions: ConditionBank, protocol: EvaluationProtocol, nfe: int, group: int
    ) -> LabelledPairs:
        """The protocol's pairs of both heads under one group of conditions."""
        seed = protocol.group_seeds(nfe, group)[0]
        samples = self.sample(conditions, protocol.pairs, nfe, protocol.coupling, seed)
        kinematics = self.kinematics
        joint = samples.joint.double()
        rotations = None
        if samples.rotation is not None:
            joint_rotation = columns_from_matrix(kinematics.rotation(joint))
            rotations = (joint_rotation.cpu().numpy(), samples.rotation.double().cpu().numpy())
        return LabelledPairs.from_paths(
            kinematics.position(joint).cpu().numpy(),
            samples.position.double().cpu().numpy(),
            conditions.state,
            conditions.partition,
            conditions.direction,
            rotations,
        )


def open_policy(path: str | Path, *, device: str = "cpu") -> EvaluatedSampler:
    """A trained policy, from its hub folder or its training run's output folder.

    Raises:
        FileNotFoundError: If there is no policy.
        ValueError: If it is damaged or of another type.
    """
    from dualhead_policy.pretrained import load_policy, policy_folder
    from dualhead_policy.training.provenance import policy_provenance

    folder = policy_folder(path)
    policy, preprocessor = load_policy(folder, device=device)
    return EvaluatedSampler(
        policy,
        preprocessor,
        policy.model.kinematics,
        {"method": "policy", **policy_provenance(policy, folder)},
        policy.config.input_features,
    )


def open_exact_reference(conditions: ConditionBank, **options: Any) -> EvaluatedSampler:
    """The exact reference for the ring that ``conditions`` were recorded from.

    Raises:
        ValueError: If the conditions are not the ring's.
    """
    from dualhead_eval.exact_reference import ExactReference

    family, _, representation = conditions.kinematic_map.partition("/")
    if family != "ring":
        raise ValueError(
            f"the exact reference exists on the ring only, not for {conditions.kinematic_map!r}: evaluate a policy"
        )
    reference = ExactReference(conditions.partition.n_modes, representation, **_ring_options(conditions), **options)
    return EvaluatedSampler(reference, dict, KinematicMap(reference.kinematic_map), reference.describe())


def open_penalised_reference(
    root: str | Path, conditions: ConditionBank, consistency_weight: float, source_noise_beta: float
) -> EvaluatedSampler:
    """The optimum of flow matching with endpoint consistency under ``conditions``, which were read from ``root``.

    Raises:
        FileNotFoundError, ValueError: See :func:`dualhead_eval.penalised_reference.opening.open_reference`.
    """
    from dualhead_eval.penalised_reference.opening import open_reference

    reference = open_reference(
        root, conditions.observation, consistency_weight, source_noise_beta, _ring_options(conditions)
    )
    return EvaluatedSampler(reference, dict, KinematicMap(reference.kinematic_map), reference.describe())


def _ring_options(conditions: ConditionBank) -> dict[str, Any]:
    names = ("mode_probabilities", "mode_angles", "path_spread")
    return {name: conditions.env_kwargs[name] for name in names if conditions.env_kwargs.get(name) is not None}
