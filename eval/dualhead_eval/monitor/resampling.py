"""Another policy on recorded observations: one log of an executing policy serves every monitored arm."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from dualhead_eval.monitor.decision import Episode
from dualhead_eval.monitor.recorded_episodes import OBSERVATIONS, RecordedEpisodes
from dualhead_policy.modeling_dualhead import DualheadPolicy
from dualhead_policy.sampling import SamplingCoupling


def resampled_episodes(
    recorded: RecordedEpisodes,
    policy: DualheadPolicy,
    preprocess: Callable[[Any], Any],
    *,
    samples: int,
    seed: int,
    coupling: SamplingCoupling | None = None,
) -> Iterator[Episode]:
    """The recorded episodes with ``policy``'s predictions, ``samples`` fresh pairs per decision.

    What the robot did stays the executing policy's; ``chunk`` is what ``policy`` would have executed. Draws are a
    function of seed and episode, whatever is scored beside. ``coupling`` is what its heads share, None what they were
    trained to.

    Raises:
        ValueError: If the policy has another layout.
    """
    layout = recorded.sidecar["layout"]
    if policy.representation.kinematic_map != layout:
        raise ValueError(
            f"{recorded.root} was recorded in the layout {layout!r}, expected the policy's "
            f"{policy.representation.kinematic_map!r}: give rollouts of the robot that it was trained on"
        )
    for number in range(len(recorded)):
        frames = recorded.decision_frames(number)
        raw = {key: torch.from_numpy(recorded.columns[key][frames]) for key in OBSERVATIONS}
        generator = torch.Generator().manual_seed(int(np.random.SeedSequence([seed, number]).generate_state(1)[0]))
        with torch.no_grad():
            drawn = policy.sample(preprocess(raw), samples, coupling=coupling, generator=generator)
        chunks: dict[int, tuple[NDArray, NDArray]] = {
            int(frame): (joint, position)
            for frame, joint, position in zip(
                frames, drawn.joint.cpu().numpy(), drawn.position.cpu().numpy(), strict=True
            )
        }
        yield recorded.episode(number, chunks.__getitem__)
