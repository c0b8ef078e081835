"""One run scored: fresh pairs of its two heads at every decision, a threshold, and alarms counted by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from dualhead_envs.dataset_frames import SplitFrames
from dualhead_eval.monitor.kinematics import position_map
from dualhead_eval.monitor.thresholds.threshold import conformal_quantile
from dualhead_eval.studies.monitor.converse.decisions import HeldOut, flagged_decisions, grid_decisions
from dualhead_eval.studies.monitor.converse.protocol import ArmName, ConverseProtocol
from dualhead_eval.studies.monitor.converse.tally import ReadingName, ReadingTally, RunTally
from dualhead_policy.modeling_dualhead import DualheadPolicy

#: Parts of a run's decisions, in the order of their draws' seeds.
_CALIBRATION, _FLAGGED, _OTHER = range(3)
Preprocessor = Callable[[Any], Mapping[str, torch.Tensor]]


@dataclass(frozen=True)
class Sampled:
    """One head's sampled chunks at D decisions, n each.

    Attributes:
        path: Positions ``(D, n, H, 3)`` in m, of head A through the kinematic map.
        token: Tokens that they follow ``(D, n)``, or None.
    """

    path: NDArray[np.float64]
    token: NDArray[np.int64] | None


def score_run(
    policy: DualheadPolicy,
    preprocess: Preprocessor,
    calibration: SplitFrames,
    test: SplitFrames,
    protocol: ConverseProtocol,
    *,
    amplitude_mm: int,
    arm: ArmName,
    seed: int,
    provenance: dict[str, Any],
) -> RunTally:
    """Score a policy on held-out demonstrations.

    Args:
        policy: The policy, in evaluation mode.
        preprocess: Its preprocessor.
        calibration: Demonstrations whose pooled decisions give the threshold.
        test: Demonstrations whose alarms are counted.
        protocol: The protocol.
        amplitude_mm, arm, seed: Side step, arm and training seed.
        provenance: What to say of the policy.

    Raises:
        ValueError: If demonstrations are not those of the protocol.
    """
    scoring, decisions = protocol.scoring, protocol.decisions
    horizon = policy.config.chunk_size
    flagged = flagged_decisions(test, decisions, horizon)
    other = grid_decisions(test, decisions, flagged=False)
    parts: tuple[tuple[HeldOut, int], ...] = (
        (grid_decisions(calibration, decisions), scoring.samples),
        (flagged, scoring.flagged_samples),
        (other, scoring.samples),
    )
    draws = [
        [
            _draw(policy, preprocess, held_out, samples, (scoring.seed, seed, part, draw))
            for draw in range(1 if policy.model.tokens is None else 2)
        ]
        for part, (held_out, samples) in enumerate(parts)
    ]
    readings: dict[ReadingName, ReadingTally] = {}
    for name, second, known in _readings(policy.model.tokens is not None):
        heads = [(drawn[0][0], drawn[second][1]) for drawn in draws]
        residual = [residual_mm(a.path, b.path) for a, b in heads]
        a, b = heads[_FLAGGED]
        crossed = a.token != b.token if known else on_two_sides(a.path, b.path, flagged.middle)
        readings[name] = tally_reading(
            conformal_quantile(residual[_CALIBRATION].ravel(), scoring.alpha),
            residual[_FLAGGED], np.asarray(crossed), flagged.pair, residual[_OTHER], other.pair, flagged.n_pairs,
        )  # fmt: skip
    separation = np.bincount(flagged.pair, flagged.separation) / np.bincount(flagged.pair)
    return RunTally(
        format="dualhead-monitor-converse-run/1",
        amplitude_mm=amplitude_mm,
        arm=arm,
        seed=seed,
        separation_mm=np.round(separation, 4).tolist(),
        readings=readings,
        provenance=provenance,
    )


def _readings(has_tokens: bool) -> list[tuple[ReadingName, int, bool]]:
    """Name of a reading, the draw of its head B, and whether tokens rather than paths tell its sides."""
    if not has_tokens:
        return [("A", 0, False)]
    return [("K apart", 1, True), ("K apart, sides from paths", 1, False), ("K together", 0, True)]


def _draw(
    policy: DualheadPolicy, preprocess: Preprocessor, held_out: HeldOut, samples: int, seed: tuple[int, ...]
) -> tuple[Sampled, Sampled]:
    """Both heads of one draw."""
    generator = torch.Generator().manual_seed(int(np.random.SeedSequence(seed).generate_state(1)[0]))
    batch = preprocess({key: torch.from_numpy(values) for key, values in held_out.observation.items()})
    drawn = policy.sample(batch, samples, generator=generator)
    token = None if drawn.token is None else drawn.token.cpu().numpy()
    decode = position_map(policy.representation.kinematic_map)
    joint, position = (chunks.cpu().numpy().astype(np.float64) for chunks in (drawn.joint, drawn.position))
    return Sampled(decode(joint), token), Sampled(position, token)


def residual_mm(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean distance over the window ``(...)`` in mm of paths ``(..., H, 3)`` in m."""
    return 1000.0 * np.linalg.norm(a - b, axis=-1).mean(axis=-1)


def on_two_sides(a: NDArray[np.float64], b: NDArray[np.float64], middle: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether chunks ``(D, n, H, 3)`` end on different sides of a lateral coordinate ``(D,)``, ``(D, n)``."""
    return (a[..., -1, 1] > middle[:, None]) != (b[..., -1, 1] > middle[:, None])


def tally_reading(
    threshold: float,
    residual: NDArray[np.float64],
    crossed: NDArray[np.bool_],
    pair: NDArray[np.int64],
    other_residual: NDArray[np.float64],
    other_pair: NDArray[np.int64],
    n_pairs: int,
) -> ReadingTally:
    """Alarms by side and pair of demonstrations.

    Args:
        threshold: In mm.
        residual: Of flagged decisions ``(D, n)`` in mm.
        crossed: Whether those pairs lie on two sides ``(D, n)``.
        pair: Pair of demonstrations of each decision ``(D,)``.
        other_residual: Of the other decisions ``(E, m)`` in mm.
        other_pair: Their pair ``(E,)``.
        n_pairs: Number of pairs of demonstrations.
    """

    def count(values: NDArray[Any], of: NDArray[np.int64]) -> list[int]:
        return np.bincount(of, values.sum(axis=1), minlength=n_pairs).astype(int).tolist()

    alarm, other_alarm = residual > threshold, other_residual > threshold
    return ReadingTally(
        threshold_mm=threshold,
        same=count(~crossed, pair),
        same_alarms=count(alarm & ~crossed, pair),
        same_mm=np.round(
            np.bincount(pair, np.where(crossed, 0.0, residual).sum(axis=1), minlength=n_pairs), 2
        ).tolist(),
        cross=count(crossed, pair),
        cross_alarms=count(alarm & crossed, pair),
        other=count(np.ones_like(other_alarm), other_pair),
        other_alarms=count(other_alarm, other_pair),
    )
