"""VFD of an ensemble: how far apart the members' velocity fields are, split by their modes (sec:vfd).

All members start from one draw of noise, each walks its own path, and every other member is asked for its velocity at
that path's states. The score of a pair of members, mean of both orders, is split by the modes at which the two paths
end. What the fields compare are normalised actions, so that the members must have one action scale.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import torch

from dualhead_eval.ensembles.evaluation import ensemble_provenance, require_ensemble
from dualhead_eval.ensembles.scores import mean_over_steps, velocity_gaps
from dualhead_eval.evaluation.conditions import ConditionBank
from dualhead_eval.evaluation.labelled_pairs import LabelledPairs, PairResidual
from dualhead_eval.evaluation.open_loop import count_pairs, label_conditions
from dualhead_eval.evaluation.protocol import EvaluationProtocol
from dualhead_eval.evaluation.samplers import EvaluatedSampler
from dualhead_eval.gate import Gate
from dualhead_policy.flow.flow_matching import coupled_source_noise
from dualhead_policy.modeling_dualhead import DualheadPolicy
from dualhead_policy.sampling import HeadSamples, SamplingCoupling

#: Scores by name, and whether they carry the time weight s / (1 - s).
VFD_SCORES = {"vfd": True, "vfd_unweighted": False}


def evaluate_velocity_disagreement(
    members: Mapping[str, EvaluatedSampler],
    conditions: ConditionBank,
    protocol: EvaluationProtocol,
    label: str,
    *,
    head: str = "position",
    progress: Callable[[int], object] | None = None,
) -> dict[str, Gate]:
    """VFD of one head of every member under every condition, with its time weight and without.

    Args:
        members: The members by name: trained policies with the conditions' layout and one action scale.
        conditions: What to evaluate under.
        protocol: Samples per condition and member, NFEs, thresholds and seed. With the pairs of an ensemble's gate of
            shared noise, the draws and modes are that gate's.
        label: Name of the run in tables.
        head: ``"position"`` or ``"joint"``.
        progress: Called with the number of conditions done, at each NFE.

    Returns:
        A gate for ``"vfd"`` and one for ``"vfd_unweighted"``, whose heads are the members, with strata
        ``"first / second"`` of the score, which has no unit.

    Raises:
        ValueError: As :func:`dualhead_eval.ensembles.evaluation.evaluate_ensemble`, or if a member is no policy or has
            another action scale than the first.
    """
    require_ensemble(members, conditions, head)
    policies = {name: _policy(name, member) for name, member in members.items()}
    _require_one_scale(policies, head)

    def label_group(group: ConditionBank, nfe: int, number: int) -> LabelledPairs:
        return _label_group(members, policies, group, protocol.pairs, nfe, head, protocol.group_seeds(nfe, number)[0])

    pairs = label_conditions(conditions, protocol, label_group, progress)
    gates = {}
    for score in VFD_SCORES:
        own = {nfe: _of_score(labelled, score) for nfe, labelled in pairs.items()}
        provenance = ensemble_provenance(
            members, conditions, protocol, label, head=head, shared_noise=True, score=score
        )
        gates[score] = count_pairs(own, conditions, protocol, provenance)
    return gates


def _label_group(
    members: Mapping[str, EvaluatedSampler],
    policies: Mapping[str, DualheadPolicy],
    conditions: ConditionBank,
    pairs: int,
    nfe: int,
    head: str,
    seed: int,
) -> LabelledPairs:
    """Modes of the members' paths under one group of conditions, and both scores between each two."""
    names = tuple(members)
    paths, fields = [], []
    source = np.empty(0)
    for name, member in members.items():
        policy = policies[name]
        batch = member.preprocess({key: torch.from_numpy(value) for key, value in conditions.observation.items()})
        generator = torch.Generator().manual_seed(seed)
        shape = (len(conditions), pairs, policy.config.chunk_size)
        # What `sample` would have drawn first itself; tokens and latents follow from the same generator.
        noise = coupled_source_noise(shape, policy.model.head_dims, 1.0, generator)
        coupling = SamplingCoupling(source_noise=noise)
        samples = policy.sample(batch, pairs, num_steps=nfe, coupling=coupling, generator=generator)
        paths.append(_positions(member, samples, head))
        source = noise[head].flatten(0, 1).numpy()
        repeated = {key: batch[key].repeat_interleave(pairs, dim=0) for key in policy.observation_keys}
        fields.append(policy.velocity_field(repeated, head, token=_rows(samples.token), latent=_rows(samples.latent)))
    label, strength = conditions.partition.score(np.stack(paths), conditions.state[:, None])
    gaps = velocity_gaps(fields, source, num_steps=nfe)
    residuals = {}
    for score, weighted in VFD_SCORES.items():
        one_way = mean_over_steps(gaps, weighted=weighted).reshape(len(names), len(names), len(conditions), pairs)
        for i, j in combinations(range(len(names)), 2):
            both_ways = 0.5 * (one_way[i, j] + one_way[j, i])
            residuals[f"{score}: {names[i]} / {names[j]}"] = PairResidual(both_ways, (names[i], names[j]), "1")
    return LabelledPairs(dict(zip(names, label, strict=True)), dict(zip(names, strength, strict=True)), residuals)


def _of_score(labelled: LabelledPairs, score: str) -> LabelledPairs:
    """The pairs with one score's residuals alone, under the names of the members."""
    start = f"{score}: "
    own = {name.removeprefix(start): r for name, r in labelled.residuals.items() if name.startswith(start)}
    return replace(labelled, residuals=own)


def _positions(member: EvaluatedSampler, samples: HeadSamples, head: str) -> np.ndarray:
    """Positions (conditions, pairs, H, d) in metres of one head's samples."""
    if head == "joint":
        return member.kinematics.position(samples.joint.double()).cpu().numpy()
    return samples.position.double().cpu().numpy()


def _rows(drawn: torch.Tensor | None) -> Any:
    """Tokens or latents (B, N, ...) as one row a sample."""
    return None if drawn is None else drawn.flatten(0, 1)


def _policy(name: str, member: EvaluatedSampler) -> DualheadPolicy:
    if not isinstance(member.sampler, DualheadPolicy):
        raise ValueError(
            f"member {name!r} is a {type(member.sampler).__name__}, expected a trained policy: VFD compares velocity "
            "fields, which a reference does not give"
        )
    return member.sampler


def _require_one_scale(policies: Mapping[str, DualheadPolicy], head: str) -> None:
    (first, reference), *others = policies.items()
    part = reference.model.head_slices[head]
    for name, policy in others:
        if not torch.allclose(policy.model.action_scale.scale[part], reference.model.action_scale.scale[part]):
            raise ValueError(
                f"members {first!r} and {name!r} normalise actions by different scales, expected members trained on "
                "the same data: VFD compares their velocities as they are"
            )
