"""One arm on the log: fresh pairs of its two heads at every decision, and what the signals say of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from dualhead_eval.effects.counts import INVALID
from dualhead_eval.monitor.decision import Decision
from dualhead_eval.monitor.recorded_episodes import OBSERVATIONS
from dualhead_eval.monitor.signals.registry import make_signal
from dualhead_eval.studies.monitor.arm_scores import ArmScores
from dualhead_eval.studies.monitor.log_table import MonitorLog
from dualhead_policy.modeling_dualhead import DualheadPolicy
from dualhead_policy.sampling import SamplingCoupling

#: Decisions sampled together; draws are a function of the block, so that this number is part of the protocol.
BLOCK = 1024


def score_arm(
    log: MonitorLog,
    policy: DualheadPolicy,
    preprocess: Callable[[Any], Mapping[str, torch.Tensor]],
    *,
    samples: int,
    seed: tuple[int, int],
    signals: list[str],
    provenance: dict[str, Any],
    coupling: SamplingCoupling | None = None,
    progress: Callable[[int], object] | None = None,
) -> ArmScores:
    """Score a policy on the log.

    Args:
        log: The log.
        policy: The arm's policy, in evaluation mode.
        preprocess: Its preprocessor.
        samples: Pairs per decision; the first counts as executed.
        seed: Seeds of the draws: the protocol's and the arm's training seed.
        signals: Names of signals that learn nothing.
        provenance: What to say of the policy.
        coupling: What the heads share; None: as they were trained.
        progress: Called with the number of decisions scored since the last call.

    Raises:
        ValueError: If the policy has another layout than the log, or the log was kept without observations.
    """
    if not log.observations:
        raise ValueError("the log was kept without observations, expected a study's own: score in its folder")
    if policy.representation.kinematic_map != log.about["layout"]:
        raise ValueError(
            f"the policy's layout is {policy.representation.kinematic_map!r} and the log's {log.about['layout']!r}, "
            "expected one robot: give an arm that was trained on the study's environment"
        )
    builder = log.builder()
    assert builder.partition is not None
    n_modes = builder.partition.n_modes
    tokens = None if policy.model.tokens is None else policy.model.tokens.n_tokens
    scored = ArmScores.empty(len(log), signals, n_modes, tokens, provenance)
    made = [make_signal(name) for name in signals]
    before = -1
    for row, decision, token, probabilities in _decisions(log, policy, preprocess, builder, samples, seed, coupling):
        if log.episode[row] != before:
            before = log.episode[row]
            for signal in made:
                signal.reset()
        for signal in made:
            scored.scores[signal.name][row] = signal.score(decision)
        scored.crossed[row] = bool(decision.crossed)
        assert decision.labels is not None
        scored.pairs[row] = joint_labels(decision.labels, n_modes)
        if scored.followed is not None and scored.entropy is not None:
            scored.followed[row] = labels_by_token(decision.labels, token, n_modes, scored.followed.shape[2])
            scored.entropy[row] = -(probabilities * np.log(np.maximum(probabilities, 1e-30))).sum()
        if progress is not None:
            progress(1)
    return scored


def _decisions(
    log: MonitorLog,
    policy: DualheadPolicy,
    preprocess: Any,
    builder: Any,
    samples: int,
    seed: tuple[int, int],
    coupling: SamplingCoupling | None,
) -> Iterator[tuple[int, Decision, NDArray, NDArray]]:
    """Every decision of the log with the policy's fresh pairs, their tokens and the tokens' probabilities."""
    for block, start in enumerate(range(0, len(log), BLOCK)):
        rows = slice(start, min(start + BLOCK, len(log)))
        batch = preprocess({key: torch.from_numpy(log.observations[key][rows]) for key in OBSERVATIONS})
        state = np.random.SeedSequence([*seed, block]).generate_state(1)[0]
        generator = torch.Generator().manual_seed(int(state))
        with torch.no_grad():
            drawn = policy.sample(batch, samples, coupling=coupling, generator=generator)
            probabilities = policy.token_probabilities(batch)
        none = np.empty((rows.stop - start, 0))
        token = none if drawn.token is None else drawn.token.cpu().numpy()
        chances = none if probabilities is None else probabilities.cpu().numpy().astype(np.float64)
        joint, position = drawn.joint.cpu().numpy(), drawn.position.cpu().numpy()
        diverged = None if drawn.diverged is None else drawn.diverged.cpu().numpy()
        for offset, row in enumerate(range(start, rows.stop)):
            decision = builder.build(
                int(log.step[row]),
                log.observations[OBSERVATIONS[0]][row],
                log.observations[OBSERVATIONS[1]][row],
                joint[offset],
                position[offset],
                diverged=None if diverged is None else diverged[offset],
            )
            yield row, decision, token[offset], chances[offset]


def joint_labels(labels: NDArray[np.int64], n_modes: int) -> NDArray[np.uint8]:
    """How many of the both-valid pairs of labels ``(2, n)`` chose each pair of modes: ``(K, K)``."""
    counts = np.zeros((n_modes, n_modes), dtype=np.uint8)
    both = (labels != INVALID).all(axis=0)
    np.add.at(counts, tuple(labels[:, both]), 1)
    return counts


def labels_by_token(
    labels: NDArray[np.int64], token: NDArray[np.int64], n_modes: int, n_tokens: int
) -> NDArray[np.uint8]:
    """How many valid chunks of either head chose each mode under each token: ``(2, n_tokens, K)``."""
    counts = np.zeros((2, n_tokens, n_modes), dtype=np.uint8)
    for head, own in enumerate(labels):
        valid = own != INVALID
        np.add.at(counts[head], (token[valid], own[valid]), 1)
    return counts
