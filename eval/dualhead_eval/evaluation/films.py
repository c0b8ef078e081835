"""Films of recorded rollouts, with both heads' predictions drawn into the scene.

At every decision the joint head's chunks are ribbons and the position head's are strings of beads, coloured by the
mode that each reaches (grey: none). The pair whose chunk is executed is wide, the others are faint. A line beneath says
whether the executed pair is in one mode, and how many of the decision's own draws are. Where a failure monitor ran
beside the episode (``--monitor``), a strip beneath shows its aggregate and threshold so far, and the alarm.

The episodes are not recorded as pictures: they are repeated, from their seeds and actions, and compared with what was
recorded.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from dualhead_envs.dataset_columns import read_columns, read_info
from dualhead_envs.recorded_environment import make_recorded
from dualhead_eval.atomic_text import write_bytes
from dualhead_eval.evaluation.decision_pictures import Decided, decided, under_line
from dualhead_eval.evaluation.monitor_strip import MONITORED, monitor_strip
from dualhead_eval.evaluation.recorded_decisions import RecordedDecisions, read_decisions

#: Episodes that are filmed, as many as `lerobot-eval` renders.
EPISODES = 10
#: Side of the pictures in pixels.
SIZE = 480
#: Seconds that a film lasts at least: a ring's episode has 16 steps.
_SHORTEST = 4.0
#: Steps of an episode from which on every second one is shown: a picture of the robot takes longer than its step.
_EVERY_SECOND = 40
#: How far a repeated observation may be from the recorded one, in its units.
_REPEATED = 1e-4


def open_filmed(env_id: str, env_kwargs: Mapping[str, Any], source: str, size: int = SIZE) -> gym.Env:
    """The environment of a recording, ready to be pictured; a robot's pictures are ``size`` pixels wide and high.

    Raises:
        ValueError: If there is no such environment, or pictures need an OpenGL that is not there.
    """
    sized = {"image_size": (size, size)} if "Bypass" in env_id else {}
    env = make_recorded(env_id, {**env_kwargs, "render_mode": "rgb_array", **sized}, source)
    env.reset(seed=0)
    try:
        env.unwrapped.picture()  # type: ignore[attr-defined]
    except RuntimeError as error:
        raise ValueError(f"a film needs pictures: {error}") from error
    return env


def film_rollouts(
    root: str | Path, folder: str | Path, *, episodes: int = EPISODES, progress: Callable[[int], object] | None = None
) -> list[Path]:
    """Write a film ``episode_000.mp4`` of each of the first episodes of a rollout dataset.

    Args:
        root: The dataset, as ``dualhead evaluate --record`` writes it.
        folder: Where the films go; it is created.
        episodes: Episodes to film at most.
        progress: Called with 1 after every film.

    Raises:
        FileNotFoundError: If there is no dataset.
        ValueError: If it holds no rollouts, pictures need an OpenGL that is not there, or an episode does not repeat
            itself under the installed version of the environment.
    """
    written = []
    for number, frames, fps in rollout_frames(root, range(episodes)):
        path = Path(folder) / f"episode_{number:03}.mp4"
        write_bytes(path, _encode(frames, fps))
        written.append(path)
        if progress is not None:
            progress(1)
    return written


def rollout_frames(
    root: str | Path, episodes: Iterable[int], *, stride: int | None = None, start: int = 0, size: int = SIZE
) -> Iterator[tuple[int, np.ndarray, int]]:
    """Number, frames (T, height, width, 3) uint8 and frames per second of recorded episodes, one by one.

    Args:
        root: The dataset.
        episodes: Numbers of episodes; those beyond the last are passed over.
        stride: Show every so many steps; by default every one, or every second of a long episode.
        start: The first step to show.
        size: Side of a robot's pictures in pixels.
    """
    root = Path(root)
    decisions = read_decisions(root)
    sidecar = decisions.sidecar
    info = read_info(root)
    watched = [f"monitor.{name}" for name in MONITORED] if "monitor.aggregate" in info["features"] else []
    columns = read_columns(root, info, ["action", "observation.state", "episode_index", *watched])
    env = open_filmed(sidecar["env_id"], sidecar["env_kwargs"], str(root), size)
    # An episode that was refused before its first step is not in the data.
    seeds = [outcome["seed"] for outcome in sidecar["outcomes"] if outcome.get("frames") != 0]
    for number in (number for number in episodes if number < len(seeds)):
        frames = np.flatnonzero(columns["episode_index"].reshape(-1) == number)
        every = stride or (1 if len(frames) < _EVERY_SECOND else 2)
        steps = range(start, len(frames), every)
        pictures = _repeat(env, decisions, columns, frames, seeds[number], steps, str(root))
        yield number, pictures, min(env.metadata["render_fps"] // every, max(1, round(len(pictures) / _SHORTEST)))
    env.close()


def _repeat(
    env: gym.Env,
    decisions: RecordedDecisions,
    columns: Mapping[str, np.ndarray],
    frames: np.ndarray,
    seed: int,
    steps: range,
    source: str,
) -> np.ndarray:
    """Pictures of one episode, by repeating it."""
    bare: Any = env.unwrapped
    executed = bare.layout.control_indices(decisions.sidecar["env_kwargs"]["control"])
    at = dict(zip(decisions.frame.tolist(), range(len(decisions.frame)), strict=True))
    observation, _ = env.reset(seed=seed)
    pictures: list[np.ndarray] = []
    shown = Decided([], "", [])
    for step, frame in enumerate(frames.tolist()):
        if not np.allclose(observation["agent_pos"], columns["observation.state"][frame], atol=_REPEATED):
            raise ValueError(
                f"{source} does not repeat itself: the episode of seed {seed} leaves its recording at step {step}; "
                "record it again with the installed versions"
            )
        if frame in at:
            shown = _decided(decisions, at[frame])
        if step in steps:
            picture = under_line(bare.picture(shown.ribbons), f"step {step}", shown.words, shown.heads)
            pictures.append(_with_monitor(picture, columns, frames, step))
        observation, _, _, _, info = env.step(columns["action"][frame][executed])
    end = "success" if info["is_success"] else "collision" if info["collision"] else "no success"
    last = under_line(bare.picture(), f"step {len(frames)}", end, [])
    last = _with_monitor(last, columns, frames, len(frames) - 1)
    return np.stack(pictures + [last] * max(1, len(pictures) // 8))


def _with_monitor(picture: np.ndarray, columns: Mapping[str, np.ndarray], frames: np.ndarray, step: int) -> np.ndarray:
    """The picture with the monitor's readings up to a step beneath it, where the recording has some."""
    if "monitor.aggregate" not in columns:
        return picture
    aggregate, threshold, alarm = (columns[f"monitor.{name}"][frames].reshape(-1) for name in MONITORED)
    return np.concatenate([picture, monitor_strip(picture.shape[1], aggregate, threshold, alarm, step)])


def _decided(decisions: RecordedDecisions, index: int) -> Decided:
    partition, condition = decisions.partition, decisions.condition[index]
    return decided(decisions.joint[index], decisions.position[index], condition, partition, held=decisions.held)


def _encode(frames: np.ndarray, fps: int) -> bytes:
    """The frames as an MP4 that browsers play."""
    import av

    buffer = io.BytesIO()
    with av.open(buffer, "w", format="mp4") as container:
        stream: Any = container.add_stream("libx264", rate=fps, options={"crf": "23"})
        stream.width, stream.height, stream.pix_fmt = frames.shape[2], frames.shape[1], "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return buffer.getvalue()
