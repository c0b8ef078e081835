"""``--env.type=bimodal_bypass`` and ``--env.type=rotating_bypass``: the bypass environments as LeRobot makes them.

Neither MuJoCo nor OpenGL is loaded here; a video needs EGL or OSMesa, evaluation without one does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lerobot.envs.configs import EnvConfig

from dualhead_envs.bypass.layout import BIMODAL_BYPASS_LAYOUT, ROTATING_BYPASS_LAYOUT
from dualhead_envs.bypass.partition import BIMODAL_TAU, ROTATING_TAU
from dualhead_envs.bypass.perturbations.perturbation import parse_perturbation
from dualhead_envs.bypass.task import BIMODAL_BYPASS, ROTATING_BYPASS, check_wall
from dualhead_envs.layout import Layout
from dualhead_envs.lerobot_config import DualheadEnvConfig


@dataclass
class BypassConfig(DualheadEnvConfig):
    """What both bypass environments let one choose; see :class:`~dualhead_envs.bypass.bimodal.BimodalBypassEnv`.

    ``env.control`` is joint, position or pose; ``env.feed_forward`` whether targets are tracked without lag;
    ``env.camera`` and ``env.image_size`` (pixels, square) are those of the videos; ``env.perturbation`` is
    KIND:SEVERITY or KIND@LEVEL (see :mod:`dualhead_envs.bypass.perturbations`).
    """

    task: str | None = None
    feed_forward: bool = True
    tau: float = BIMODAL_TAU
    camera: str | None = None
    image_size: int = 256
    perturbation: str | None = None

    def __post_init__(self) -> None:
        env_id = self.env_id
        if self.task not in (None, env_id):
            raise ValueError(f"env.task={self.task!r} contradicts env.type={self.type} ({env_id}): leave it out")
        self.task = env_id
        if not self.tau > 0:
            raise ValueError(f"env.tau={self.tau} should be a positive length in metres, for example {BIMODAL_TAU}")
        if self.perturbation is not None:
            parse_perturbation(self.perturbation, env_id)  # refuses what does not exist before any environment is made
        if self.image_size < 1:
            raise ValueError(f"env.image_size={self.image_size} should be a number of pixels, for example 256")
        super().__post_init__()

    @property
    def env_id(self) -> str:
        """The Gymnasium id."""
        raise NotImplementedError

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        return {
            "control": self.control,
            "feed_forward": self.feed_forward,
            "tau": self.tau,
            "camera": self.camera,
            "image_size": (self.image_size, self.image_size),
            "render_mode": self.render_mode,
            "perturbation": self.perturbation,
        }


@EnvConfig.register_subclass("bimodal_bypass")
@dataclass
class BimodalBypassConfig(BypassConfig):
    """BimodalBypass-v2: past a wall, left or right; with ``env.ways=3`` over it as well, ``env.obstacle=none`` without.

    ``env.amplitude`` (m) is how far aside demonstrations go without the wall; it changes no episode.
    """

    ways: int = 2
    obstacle: str = "wall"
    amplitude: float | None = None

    def __post_init__(self) -> None:
        check_wall(self.obstacle, self.amplitude)
        if self.ways not in (2, 3):
            raise ValueError(f"env.ways={self.ways} should be 2 (left, right) or 3 (left, right, over the wall)")
        super().__post_init__()

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        return super().gym_kwargs | {"ways": self.ways, "obstacle": self.obstacle, "amplitude": self.amplitude}

    @property
    def env_id(self) -> str:
        return BIMODAL_BYPASS.env_id

    @property
    def layout(self) -> Layout:
        return BIMODAL_BYPASS_LAYOUT


@EnvConfig.register_subclass("rotating_bypass")
@dataclass
class RotatingBypassConfig(BypassConfig):
    """RotatingBypass-v3: past a beam, by one of two routes that every episode draws anew."""

    tau: float = ROTATING_TAU

    @property
    def env_id(self) -> str:
        return ROTATING_BYPASS.env_id

    @property
    def layout(self) -> Layout:
        return ROTATING_BYPASS_LAYOUT
