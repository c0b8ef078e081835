"""From a sampler and conditions to a gate: sample both heads, label their paths, count."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

import numpy as np
import torch

from dualhead_eval.effects.counts import joint_table
from dualhead_eval.evaluation.labelled_pairs import ROTATION, LabelledPairs, ModePartition
from dualhead_eval.gate.gate import Gate
from dualhead_eval.residuals.strata import residual_strata
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.kinematics.rotation6d import columns_from_matrix
from dualhead_policy.sampling import Sampler, SamplingCoupling

#: The frozen protocol (sec:gate): 64 samples in each of 20 draws a condition, 20 Euler steps.
FROZEN_PAIRS = 64 * 20
FROZEN_NFE = 20
#: Conditions sampled together. Their draws are keyed by the seed and the group's number.
GROUP = 25


@dataclass(frozen=True)
class EvaluationProtocol:
    """How to evaluate.

    Attributes:
        pairs: Sample pairs per condition.
        nfes: Euler steps to scan; the first is the reference.
        taus: Thresholds to scan beside the partition's own, which is the reference.
        seed: Seed of all draws.
        coupling: What the heads share.
    """

    pairs: int = FROZEN_PAIRS
    nfes: Sequence[int] = (FROZEN_NFE,)
    taus: Sequence[float] = ()
    seed: int = 0
    coupling: SamplingCoupling = field(default_factory=SamplingCoupling)


def sample_pairs(
    sampler: Sampler,
    preprocess: Callable[[dict[str, torch.Tensor]], Mapping[str, torch.Tensor]],
    kinematic_map: str,
    observation: Mapping[str, np.ndarray],
    partition: ModePartition,
    protocol: EvaluationProtocol,
    nfe: int,
    direction: np.ndarray | None = None,
    progress: Callable[[int], object] | None = None,
) -> LabelledPairs:
    """Sample ``protocol.pairs`` chunks of both heads under every condition and score their modes.

    Args:
        sampler: A policy or the exact reference.
        preprocess: Turns raw observations into what the sampler takes.
        kinematic_map: Name of the map from head A's space to the position.
        observation: Raw observations of the conditions by LeRobot key, each (B, dim).
        partition: The environment's mode partition.
        protocol: Pairs, seed and coupling.
        nfe: Euler steps.
        direction: Direction that separates the modes of every condition (B, d), to split the residual along it.
        progress: Called with the number of conditions done.
    """
    condition = observation["observation.environment_state"]
    kinematics = KinematicMap(kinematic_map)
    parts = []
    for number, start in enumerate(range(0, len(condition), GROUP)):
        group = slice(start, start + GROUP)
        batch = preprocess({key: torch.from_numpy(value[group]) for key, value in observation.items()})
        seed = int(np.random.SeedSequence([protocol.seed, nfe, number]).generate_state(1, np.uint64)[0] >> 1)
        samples = sampler.sample(
            batch,
            protocol.pairs,
            num_steps=nfe,
            coupling=protocol.coupling,
            generator=torch.Generator().manual_seed(seed),
        )
        rotations = None
        if samples.rotation is not None:
            joint_rotation = columns_from_matrix(kinematics.rotation(samples.joint.double()))
            rotations = (joint_rotation.cpu().numpy(), samples.rotation.double().cpu().numpy())
        parts.append(
            LabelledPairs.from_paths(
                kinematics.position(samples.joint.double()).cpu().numpy(),
                samples.position.double().cpu().numpy(),
                condition[group],
                partition,
                None if direction is None else direction[group],
                rotations,
            )
        )
        if progress is not None:
            progress(len(condition[group]))
    return LabelledPairs.join(parts)


def make_gate(
    pairs: Mapping[int, LabelledPairs],
    *,
    reference_nfe: int,
    taus: Sequence[float],
    conditions: np.ndarray,
    pair_ids: np.ndarray,
    partition: ModePartition,
    target_probabilities: Sequence[float] | None,
    provenance: dict[str, Any],
) -> Gate:
    """Count labelled pairs, by NFE, into a gate.

    Args:
        pairs: Labelled pairs for every NFE.
        reference_nfe: The NFE of headline numbers.
        taus: Further thresholds; the partition's own is always there and is the reference.
        conditions: Environment states (conditions, C).
        pair_ids: Pair of every condition.
        partition: The mode partition.
        target_probabilities: Mode frequencies of the data, or None.
        provenance: Where the pairs came from; versions and the partition are added.
    """
    nfes, all_taus = sorted(pairs), sorted({float(partition.tau), *map(float, taus)})
    heads = pairs[nfes[0]].heads
    labels = [[pairs[nfe].at(tau) for tau in all_taus] for nfe in nfes]
    counts = np.stack(
        [np.stack([joint_table([at[head] for head in heads], partition.n_modes) for at in row]) for row in labels]
    )
    by_head = {head: np.stack([np.stack([at[head] for at in row]) for row in labels]) for head in heads}
    strata = {
        component: residual_strata(
            np.stack([np.stack([pairs[nfe].residuals[component]] * len(all_taus)) for nfe in nfes]),
            by_head["joint"],
            by_head.get(ROTATION, by_head["position"]) if component == ROTATION else by_head["position"],
            unit="deg" if component == ROTATION else "mm",
        )
        for component in pairs[nfes[0]].residuals
    }
    return Gate(
        heads=heads,
        n_modes=partition.n_modes,
        taus=all_taus,
        nfes=nfes,
        reference_tau=float(partition.tau),
        reference_nfe=reference_nfe,
        counts=counts,
        conditions=np.asarray(conditions, dtype=np.float64),
        pair_ids=np.asarray(pair_ids, dtype=np.int64),
        target_probabilities=None if target_probabilities is None else np.asarray(target_probabilities),
        provenance={
            **provenance,
            "partition": partition.to_dict(),
            "versions": {name: version(name) for name in ("lerobot_policy_dualhead", "lerobot", "torch", "numpy")},
        },
        strata=strata,
    )


def evaluate_sampler(
    sampler: Sampler,
    preprocess: Callable[[dict[str, torch.Tensor]], Mapping[str, torch.Tensor]],
    kinematic_map: str,
    observation: Mapping[str, np.ndarray],
    pair_ids: np.ndarray,
    partition: ModePartition,
    protocol: EvaluationProtocol,
    *,
    direction: np.ndarray | None = None,
    target_probabilities: Sequence[float] | None = None,
    provenance: dict[str, Any] | None = None,
    progress: Callable[[int], object] | None = None,
) -> Gate:
    """Evaluate a sampler under every condition, for every NFE and threshold of the protocol.

    See :func:`sample_pairs` and :func:`make_gate` for the arguments.
    """
    pairs = {
        nfe: sample_pairs(
            sampler, preprocess, kinematic_map, observation, partition, protocol, nfe, direction, progress
        )
        for nfe in protocol.nfes
    }
    coupling = protocol.coupling
    return make_gate(
        pairs,
        reference_nfe=protocol.nfes[0],
        taus=protocol.taus,
        conditions=observation["observation.environment_state"],
        pair_ids=pair_ids,
        partition=partition,
        target_probabilities=target_probabilities,
        provenance={
            **(provenance or {}),
            "pairs_per_condition": protocol.pairs,
            "seed": protocol.seed,
            "coupling": {
                "source_noise_beta": coupling.source_noise_beta,
                "share_token": coupling.share_token,
            },
        },
    )
