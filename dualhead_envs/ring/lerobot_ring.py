"""``--env.type=rotating_ring``: the ring as LeRobot makes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lerobot.envs.configs import EnvConfig

from dualhead_envs.layout import Layout
from dualhead_envs.lerobot_config import DualheadEnvConfig
from dualhead_envs.registration import ENVIRONMENTS
from dualhead_envs.ring.geometry import PATH_SPREAD, TAU
from dualhead_envs.ring.layout import ring_layout
from dualhead_envs.ring.task import RingTask


@EnvConfig.register_subclass("rotating_ring")
@dataclass
class RotatingRingConfig(DualheadEnvConfig):
    """RotatingRing with ``n_modes`` modes; other fields as in :class:`~dualhead_envs.ring.task.RingTask`."""

    task: str | None = None
    n_modes: int = 2
    representation: str = "orthogonal"
    mode_probabilities: list[float] | None = None
    mode_angles: list[float] | None = None
    path_spread: float = PATH_SPREAD
    tau: float = TAU

    def __post_init__(self) -> None:
        env_id = f"RotatingRing-v{self.n_modes}"
        if env_id not in ENVIRONMENTS:
            known = [arguments["kwargs"]["n_modes"] for name, arguments in ENVIRONMENTS.items() if "Ring" in name]
            raise ValueError(f"env.n_modes={self.n_modes} has no environment, expected one of {known}")
        if self.task not in (None, env_id):
            raise ValueError(
                f"env.task={self.task!r} is not {env_id}, as env.n_modes={self.n_modes} asks: set env.n_modes alone"
            )
        self.task = env_id
        super().__post_init__()
        RingTask(self.n_modes, **self.gym_kwargs)  # refuses bad settings here, not in a worker

    @property
    def layout(self) -> Layout:
        return ring_layout(self.representation)

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        return {
            "representation": self.representation,
            "control": self.control,
            "mode_probabilities": self.mode_probabilities,
            "mode_angles": self.mode_angles,
            "path_spread": self.path_spread,
            "tau": self.tau,
            "render_mode": self.render_mode,
        }
