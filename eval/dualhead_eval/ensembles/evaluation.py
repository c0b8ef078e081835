"""An ensemble under the evaluator: do its members choose modes together, and what shares their noise? (sec:crn)

The members take the place of the heads: one head of each is sampled under every condition, with private or
shared initial noise, and the joint table of all members' labels makes a gate like any other. Action-L2 between
each two members is split by their modes, so that the report prints its contamination.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from dualhead_eval.ensembles.scores import action_l2
from dualhead_eval.evaluation.conditions import ConditionBank
from dualhead_eval.evaluation.labelled_pairs import LabelledPairs, PairResidual
from dualhead_eval.evaluation.open_loop import count_pairs, label_conditions
from dualhead_eval.evaluation.protocol import EvaluationProtocol
from dualhead_eval.evaluation.samplers import EvaluatedSampler
from dualhead_eval.gate import Gate


def evaluate_ensemble(
    members: Mapping[str, EvaluatedSampler],
    conditions: ConditionBank,
    protocol: EvaluationProtocol,
    label: str,
    *,
    head: str = "position",
    shared_noise: bool = True,
    progress: Callable[[int], object] | None = None,
) -> Gate:
    """Evaluate one head of every member under every condition, for every NFE and threshold of the protocol.

    Args:
        members: The members by name; all with the conditions' layout.
        conditions: What to evaluate under.
        protocol: Pairs (here: samples per condition and member), NFEs, thresholds and seed. Of its coupling
            ``source_noise_beta`` is not used: a member's two heads have private noise.
        label: Name of the run in tables.
        head: ``"position"`` or ``"joint"``.
        shared_noise: Whether all members start from one draw of noise (and token), or each from its own.
        progress: Called with the number of conditions done, at each NFE.

    Returns:
        A gate whose heads are the members, with strata ``"first / second"`` of Action-L2 in millimetres.

    Raises:
        ValueError: If fewer than two members are given, one has another layout than the conditions, or there is no
            such head.
    """
    require_ensemble(members, conditions, head)

    def label_group(group: ConditionBank, nfe: int, number: int) -> LabelledPairs:
        common, *own = protocol.group_seeds(nfe, number, 1 + len(members))
        seeds = [common] * len(members) if shared_noise else own
        paths = [
            _positions(member, group, protocol, nfe, head, seed)
            for member, seed in zip(members.values(), seeds, strict=True)
        ]
        return _label_members(tuple(members), np.stack(paths), group)

    pairs = label_conditions(conditions, protocol, label_group, progress)
    provenance = ensemble_provenance(
        members, conditions, protocol, label, head=head, shared_noise=shared_noise, score="action_l2"
    )
    return count_pairs(pairs, conditions, protocol, provenance)


def require_ensemble(members: Mapping[str, EvaluatedSampler], conditions: ConditionBank, head: str) -> None:
    """Refuse what is no ensemble under ``conditions``.

    Raises:
        ValueError: If fewer than two members are given, one has another layout than the conditions, or there is no
            such head.
    """
    if len(members) < 2:
        raise ValueError(f"{len(members)} member(s) given, expected two or more: an ensemble disagrees in pairs")
    if head not in ("position", "joint"):
        raise ValueError(f"head={head!r} is not 'position' or 'joint': choose one of these")
    for name, member in members.items():
        try:
            member.require_conditions(conditions)
        except ValueError as error:
            raise ValueError(f"member {name!r}: {error}") from error


def ensemble_provenance(
    members: Mapping[str, EvaluatedSampler],
    conditions: ConditionBank,
    protocol: EvaluationProtocol,
    label: str,
    *,
    head: str,
    shared_noise: bool,
    score: str,
) -> dict[str, Any]:
    """What an ensemble's gate says of its evaluation; ``score`` names what its strata hold."""
    return {
        "label": label,
        "method": "ensemble",
        "members": {name: member.provenance for name, member in members.items()},
        "head": head,
        "shared_noise": shared_noise,
        "score": score,
        **conditions.provenance,
        "pairs_per_condition": protocol.pairs,
        "seed": protocol.seed,
    }


def _positions(
    member: EvaluatedSampler, conditions: ConditionBank, protocol: EvaluationProtocol, nfe: int, head: str, seed: int
) -> np.ndarray:
    """Positions (conditions, pairs, H, d) in metres of one member's head."""
    # One seed gives one noise: with equal seeds every member starts from the same draw.
    coupling = replace(protocol.coupling, source_noise_beta=1.0)
    drawn = member.sample(conditions, protocol.pairs, nfe, coupling, seed)
    if head == "joint":
        return member.kinematics.position(drawn.joint.double()).cpu().numpy()
    return drawn.position.double().cpu().numpy()


def _label_members(names: tuple[str, ...], paths: np.ndarray, conditions: ConditionBank) -> LabelledPairs:
    """Modes of the members' paths (M, conditions, pairs, H, d), and Action-L2 between each two."""
    label, strength = conditions.partition.score(paths, conditions.state[:, None])
    distance = 1000 * action_l2(paths)
    return LabelledPairs(
        dict(zip(names, label, strict=True)),
        dict(zip(names, strength, strict=True)),
        {
            f"{names[i]} / {names[j]}": PairResidual(distance[i, j], (names[i], names[j]))
            for i, j in combinations(range(len(names)), 2)
        },
    )
