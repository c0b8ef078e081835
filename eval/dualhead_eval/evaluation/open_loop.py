"""Open-loop evaluation: sample both heads under every condition, label their paths, count them into a gate.

Whatever is sampled walks the conditions in the same groups (:func:`label_conditions`) and is counted by the same rule
(:func:`count_pairs`): ensembles do so as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from dualhead_eval.evaluation.conditions import ConditionBank
from dualhead_eval.evaluation.labelled_pairs import LabelledPairs, make_gate
from dualhead_eval.evaluation.protocol import EvaluationProtocol
from dualhead_eval.evaluation.samplers import EvaluatedSampler
from dualhead_eval.gate import Gate
from dualhead_policy.kinematics.rotation6d import columns_from_matrix


def evaluate(
    sampler: EvaluatedSampler,
    conditions: ConditionBank,
    protocol: EvaluationProtocol,
    label: str,
    *,
    progress: Callable[[int], object] | None = None,
) -> Gate:
    """Evaluate a sampler under every condition, for every NFE and threshold of the protocol.

    Args:
        sampler: A policy or the exact reference; see :mod:`dualhead_eval.evaluation.samplers`.
        conditions: What to evaluate under; see :func:`dualhead_eval.evaluation.conditions.open_conditions`.
        protocol: Pairs, NFEs, thresholds, seed and coupling.
        label: Name of the run in tables.
        progress: Called with the number of conditions done, at each NFE.

    Raises:
        ValueError: If sampler and conditions have different layouts or observations.
    """
    sampler.require_conditions(conditions)

    def label_group(group: ConditionBank, nfe: int, number: int) -> LabelledPairs:
        return _label_pairs(sampler, group, protocol, nfe, protocol.group_seeds(nfe, number)[0])

    pairs = label_conditions(conditions, protocol, label_group, progress)
    return count_pairs(pairs, conditions, protocol, gate_provenance(sampler, conditions, protocol, label))


def label_conditions(
    conditions: ConditionBank,
    protocol: EvaluationProtocol,
    label_group: Callable[[ConditionBank, int, int], LabelledPairs],
    progress: Callable[[int], object] | None = None,
) -> dict[int, LabelledPairs]:
    """Labelled pairs of all conditions by NFE: ``label_group(group, nfe, number)`` of each group of them, joined."""
    pairs = {}
    for nfe in protocol.nfes:
        parts = []
        for number, rows in enumerate(protocol.groups(len(conditions))):
            group = conditions[rows]
            parts.append(label_group(group, nfe, number))
            if progress is not None:
                progress(len(group))
        pairs[nfe] = LabelledPairs.join(parts)
    return pairs


def count_pairs(
    pairs: Mapping[int, LabelledPairs],
    conditions: ConditionBank,
    protocol: EvaluationProtocol,
    provenance: Mapping[str, Any],
) -> Gate:
    """Count labelled pairs, by NFE, under the conditions and protocol that they were drawn under."""
    return make_gate(
        pairs,
        reference_nfe=protocol.reference_nfe,
        taus=protocol.taus,
        conditions=conditions.state,
        pair_ids=conditions.pair_ids,
        partition=conditions.partition,
        target_probabilities=conditions.target_probabilities,
        provenance=provenance,
    )


def gate_provenance(
    sampler: EvaluatedSampler, conditions: ConditionBank, protocol: EvaluationProtocol, label: str
) -> dict[str, Any]:
    """What a gate says of its evaluation, beside versions and partition."""
    return {"label": label, **sampler.provenance, **conditions.provenance, **protocol.describe()}


def _label_pairs(
    sampler: EvaluatedSampler, conditions: ConditionBank, protocol: EvaluationProtocol, nfe: int, seed: int
) -> LabelledPairs:
    """The protocol's pairs under one group of conditions."""
    samples = sampler.sample(conditions, protocol.pairs, nfe, protocol.coupling, seed)
    kinematics = sampler.kinematics
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
