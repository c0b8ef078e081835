"""An ensemble under the evaluator: do its members choose modes together, and what shares their noise? (sec:crn)

The members take the place of the heads: one head of each is sampled under every condition, with private or
shared initial noise, and the joint table of all members' labels makes a gate like any other. Action-L2 between
each two members is split by their modes, so that the report prints its contamination.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import combinations
from typing import Any

import numpy as np
import torch

from dualhead_eval.effects.counts import joint_table
from dualhead_eval.ensembles.scores import action_l2
from dualhead_eval.evaluation.open_loop import ModePartition
from dualhead_eval.evaluation.samplers import ConditionBank, Source
from dualhead_eval.gate.gate import Gate
from dualhead_eval.residuals.strata import residual_strata
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.sampling import SamplingCoupling

#: Conditions sampled together; their noise is keyed by the seed and the group's number.
_GROUP = 25


def evaluate_ensemble(
    members: Mapping[str, Source],
    bank: ConditionBank,
    *,
    head: str = "position",
    shared_noise: bool = True,
    pairs: int = 1280,
    nfe: int = 20,
    seed: int = 0,
    label: str = "ensemble",
    progress: Callable[[int], object] | None = None,
) -> Gate:
    """Evaluate one head of every member under every condition.

    Args:
        members: The members by name; all with the bank's layout.
        bank: Conditions and their mode partition.
        head: ``"position"`` or ``"joint"``.
        shared_noise: Whether all members start from one draw of noise (and token), or each from its own.
        pairs: Samples per condition and member.
        nfe: Euler steps.
        seed: Seed of all draws.
        label: Name of the run.
        progress: Called with the number of conditions done.

    Returns:
        A gate whose heads are the members, with strata ``"first / second"`` of Action-L2 in millimetres.

    Raises:
        ValueError: If fewer than two members are given, or one has another layout than the conditions.
    """
    if len(members) < 2:
        raise ValueError(f"{len(members)} member(s) given, expected two or more: an ensemble disagrees in pairs")
    for name, source in members.items():
        if source.kinematic_map != bank.kinematic_map:
            raise ValueError(
                f"member {name!r} has the layout {source.kinematic_map!r}, the conditions {bank.kinematic_map!r}: "
                "evaluate on conditions of the members' layout"
            )
    condition = bank.observation["observation.environment_state"]
    parts = []
    for number, start in enumerate(range(0, len(condition), _GROUP)):
        group = slice(start, start + _GROUP)
        raw = {key: torch.from_numpy(value[group]) for key, value in bank.observation.items()}
        key = np.random.SeedSequence([seed, nfe, number]).generate_state(1 + len(members), np.uint64) >> 1
        seeds = [int(key[0])] * len(members) if shared_noise else [int(k) for k in key[1:]]
        paths = [
            _positions(source, raw, head, pairs, nfe, member_seed)
            for source, member_seed in zip(members.values(), seeds, strict=True)
        ]
        parts.append(_labels_and_distances(np.stack(paths), condition[group], bank.partition))
        if progress is not None:
            progress(len(condition[group]))
    labels, distances = (np.concatenate(part, axis=-2) for part in zip(*parts, strict=True))
    provenance = _provenance(members, head, shared_noise, pairs, seed, label)
    return _gate(tuple(members), labels, distances, bank, nfe, provenance)


def _positions(
    source: Source, raw: Mapping[str, torch.Tensor], head: str, pairs: int, nfe: int, seed: int
) -> np.ndarray:
    """Positions (conditions, pairs, H, d) in metres of one member's head."""
    # One seed gives one noise: with equal seeds every member starts from the same draw.
    drawn = source.sampler.sample(
        source.preprocess(dict(raw)),
        pairs,
        num_steps=nfe,
        coupling=SamplingCoupling(source_noise_beta=1.0),
        generator=torch.Generator().manual_seed(seed),
    )
    if head == "joint":
        return KinematicMap(source.kinematic_map).position(drawn.joint.double()).cpu().numpy()
    return drawn.position.double().cpu().numpy()


def _labels_and_distances(
    paths: np.ndarray, condition: np.ndarray, partition: ModePartition
) -> tuple[np.ndarray, np.ndarray]:
    """Labels (M, conditions, pairs) at the partition's threshold, and Action-L2 (M, M, conditions, pairs) in mm."""
    labels, strength = partition.score(paths, condition[:, None])
    return np.where(strength >= partition.tau, labels, -1), 1000 * action_l2(paths)


def _gate(
    names: tuple[str, ...],
    labels: np.ndarray,
    distances: np.ndarray,
    bank: ConditionBank,
    nfe: int,
    provenance: dict[str, Any],
) -> Gate:
    partition = bank.partition
    return Gate(
        heads=names,
        n_modes=partition.n_modes,
        taus=[float(partition.tau)],
        nfes=[nfe],
        reference_tau=float(partition.tau),
        reference_nfe=nfe,
        counts=joint_table(list(labels), partition.n_modes)[None, None],
        conditions=np.asarray(bank.observation["observation.environment_state"], dtype=np.float64),
        pair_ids=np.asarray(bank.pair_ids, dtype=np.int64),
        target_probabilities=None if bank.target_probabilities is None else np.asarray(bank.target_probabilities),
        provenance=provenance | bank.provenance | {"partition": partition.to_dict()},
        strata={
            f"{names[i]} / {names[j]}": residual_strata(distances[i, j][None, None], *(m[None, None] for m in pair))
            for i, j in combinations(range(len(names)), 2)
            for pair in [(labels[i], labels[j])]
        },
    )


def _provenance(
    members: Mapping[str, Source], head: str, shared_noise: bool, pairs: int, seed: int, label: str
) -> dict[str, Any]:
    return {
        "label": label,
        "method": "ensemble",
        "members": {name: source.provenance for name, source in members.items()},
        "head": head,
        "shared_noise": shared_noise,
        "pairs_per_condition": pairs,
        "seed": seed,
    }
