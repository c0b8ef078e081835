"""A picture of the demonstrations from one initial state: every way past the obstacle, frame by frame."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from dualhead_envs.atomic_files import write_atomically
from dualhead_envs.bypass.demonstrations import Demonstration, demonstrate_modes
from dualhead_envs.bypass.environment import BypassEnv

#: Moments of an episode, in steps after the branch, that the contact sheet shows.
_MOMENTS = (-84, -20, 6, 14, 34, 56, 80)
_SUFFIXES = (".png", ".gif")


def write_preview(env_id: str, path: Path | str, *, seed: int = 0, **settings: Any) -> str:
    """Show every mode's demonstration from the initial state of ``seed``, as a contact sheet (.png) or a film (.gif).

    Where OpenGL is missing, a .png is a plot of the measured paths around the obstacle instead.

    Args:
        env_id: ``"BimodalBypass-v2"`` or ``"RotatingBypass-v3"``.
        path: The file to write; its suffix decides.
        seed: Seed of the initial state.
        settings: Arguments of the environment that decide what is demonstrated: ``ways``, ``obstacle``, ``amplitude``.

    Returns:
        One sentence that says what the picture shows.

    Raises:
        ValueError: If the suffix is neither .png nor .gif.
        RuntimeError: If a .gif is asked for and OpenGL is missing.
    """
    path = Path(path)
    if path.suffix not in _SUFFIXES:
        raise ValueError(f"preview={str(path)!r} should end in .png (contact sheet or plot) or .gif (film)")
    size = (180, 180) if path.suffix == ".gif" else (200, 200)
    env: Any = gym.make(f"dualhead_envs:{env_id}", control="pose", render_mode="rgb_array", image_size=size, **settings)
    bypass: BypassEnv = env.unwrapped
    shown = demonstrate_modes(bypass, seed)
    try:
        bypass.render()
    except RuntimeError as error:
        if path.suffix == ".gif":
            raise
        _plot_paths(bypass, shown.demonstrations, path)
        return f"{path} plots the measured path of every mode; it is not rendered, because {error}"
    if path.suffix == ".gif":
        _write_film(bypass, shown.demonstrations, path)
    else:
        _write_sheet(bypass, shown.demonstrations, shown.branch_step, path)
    bypass.close()
    return f"{path} shows every mode's demonstration from the initial state of seed {seed}"


def _replayed(env: BypassEnv, demonstration: Demonstration, steps: set[int]) -> list[np.ndarray]:
    """Pictures of ``demonstration`` at ``steps``, by repeating it."""
    env.reset(options={"state": {"environment_state": demonstration.environment_state[0]}})
    indices = env.layout.control_indices(env.control)
    pictures = []
    for step, action in enumerate(demonstration.actions()):
        if step in steps:
            pictures.append(env.picture())
        if env.step(action[indices])[2]:
            break
    pictures.append(env.picture())
    return pictures


def _indexed(picture: np.ndarray) -> Any:
    """``picture`` in few colours, small on disk; rare colours, such as the cube's, are kept."""
    from PIL import Image

    return Image.fromarray(picture).quantize(128, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)


def _write_sheet(env: BypassEnv, modes: tuple[Demonstration, ...], branch_step: int, path: Path) -> None:
    steps = {branch_step + moment for moment in _MOMENTS}
    rows = [np.concatenate(_replayed(env, demonstration, steps), axis=1) for demonstration in modes]
    picture = io.BytesIO()
    _indexed(np.concatenate(rows)).save(picture, format="PNG", optimize=True)
    write_atomically(path, picture.getvalue())


def _write_film(env: BypassEnv, modes: tuple[Demonstration, ...], path: Path) -> None:
    steps = set(range(0, len(modes[0].gripper), 4))
    films = [_replayed(env, demonstration, steps) for demonstration in modes]
    frames = [_indexed(np.concatenate(pictures, axis=1)) for pictures in zip(*films, strict=False)]
    film = io.BytesIO()
    frames[0].save(film, format="GIF", save_all=True, append_images=frames[1:], duration=200, loop=0, optimize=True)
    write_atomically(path, film.getvalue())


def _plot_paths(env: BypassEnv, modes: tuple[Demonstration, ...], path: Path) -> None:
    """The paths of the grip site, from above and along x, with the obstacle and the goal."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    task = env.bypass
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    above, along = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
    for axes, (i, j) in ((above, (0, 1)), (along, (1, 2))):
        center = np.array(task.obstacle_center)[[i, j]]
        half = np.array(task.obstacle_half_size)[[i, j]]
        if task.has_obstacle:
            axes.add_patch(Rectangle(tuple(center - half), *(2 * half), color="#335277", label="obstacle"))
        axes.plot(*np.array(task.goal)[[i, j]], "o", color="#339955", label="goal")
        for mode, (demonstration, color) in enumerate(zip(modes, ("#d1495b", "#edae49", "#66a182"), strict=False)):
            axes.plot(*demonstration.positions()[:, [i, j]].T, color=color, label=f"grip site, mode {mode}")
        axes.set_xlabel(f"{'xyz'[i]} (m)")
        axes.set_ylabel(f"{'xyz'[j]} (m)")
        axes.set_aspect("equal")
    above.set_title("from above")
    along.set_title("along x")
    figure.legend(*above.get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=4)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=110)
    write_atomically(path, picture.getvalue())
