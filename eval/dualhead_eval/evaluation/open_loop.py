"""Open-loop evaluation: sample pairs of chunks under every condition, label their paths, count them into a gate.

Whatever is sampled walks the conditions in the same groups (:func:`label_conditions`) and is counted by the same rule
(:func:`count_pairs`): ensembles do so as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from dualhead_eval.evaluation.conditions import ConditionBank
from dualhead_eval.evaluation.labelled_pairs import LabelledPairs, make_gate
from dualhead_eval.evaluation.protocol import EvaluationProtocol
from dualhead_eval.gate import Gate


class PairSource(Protocol):
    """What pairs of chunks come from: two heads of one sampler, two draws of one head, or two policies."""

    @property
    def provenance(self) -> dict[str, Any]:
        """What a gate says of it; complete once :meth:`require_conditions` has been called."""
        ...

    @property
    def default_nfe(self) -> int:
        """Integration or denoising steps per sample, where the caller asks for no number."""
        ...

    def require_conditions(self, conditions: ConditionBank) -> None:
        """Refuse conditions that do not fit."""
        ...

    def label_pairs(
        self, conditions: ConditionBank, protocol: EvaluationProtocol, nfe: int, group: int
    ) -> LabelledPairs:
        """The protocol's pairs under one group of conditions."""
        ...


def evaluate(
    sampler: PairSource,
    conditions: ConditionBank,
    protocol: EvaluationProtocol,
    label: str,
    *,
    progress: Callable[[int], object] | None = None,
) -> Gate:
    """Evaluate a sampler under every condition, for every NFE and threshold of the protocol.

    Args:
        sampler: Two heads of a policy or of the exact reference (:mod:`dualhead_eval.evaluation.samplers`), two draws
            of one head, or two policies (:mod:`dualhead_eval.evaluation.draws`).
        conditions: What to evaluate under; see :func:`dualhead_eval.evaluation.conditions.open_conditions`.
        protocol: Pairs, NFEs, thresholds, seed and coupling.
        label: Name of the run in tables.
        progress: Called with the number of conditions done, at each NFE.

    Raises:
        ValueError: If sampler and conditions have different layouts or observations.
    """
    sampler.require_conditions(conditions)

    def label_group(group: ConditionBank, nfe: int, number: int) -> LabelledPairs:
        return sampler.label_pairs(group, protocol, nfe, number)

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
    sampler: PairSource, conditions: ConditionBank, protocol: EvaluationProtocol, label: str
) -> dict[str, Any]:
    """What a gate says of its evaluation, beside versions and partition."""
    return {"label": label, **sampler.provenance, **conditions.provenance, **protocol.describe()}
