"""What the ring's single and vector environments share: validated settings and the dynamics as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dualhead_envs.ring import geometry
from dualhead_envs.ring.generator import RingGenerator
from dualhead_envs.ring.layout import ARENA, ring_layout
from dualhead_envs.ring.maps import representation_map
from dualhead_envs.ring.partition import RingPartition

RESET_OPTIONS = {"state", "lerobot_new_rollout"}  # lerobot-eval marks the start of a rollout with the latter


class RingTask:
    """The settings of a ring environment and its stateless rules, vectorised over leading axes.

    Args:
        n_modes: Number of modes K, at least 2.
        representation: How head A writes a point: ``"orthogonal"``, ``"polar"`` or ``"nullspace"``.
        control: What an action is: ``"joint"`` (head A's representation) or ``"position"``.
        mode_probabilities: The expert's prior over modes, uniform by default.
        mode_angles: Offsets of the modes from theta in radians, equally spaced by default.
        path_spread: Standard deviation of the expert's common offset in metres.
        tau: Threshold of the mode partition.
        render_mode: ``None`` or ``"rgb_array"``.

    Raises:
        ValueError: If an argument is not one of these.
    """

    def __init__(
        self,
        n_modes: int = 2,
        representation: str = "orthogonal",
        control: str = "joint",
        mode_probabilities: Sequence[float] | None = None,
        mode_angles: Sequence[float] | None = None,
        path_spread: float = geometry.PATH_SPREAD,
        tau: float = geometry.TAU,
        render_mode: str | None = None,
    ):
        if render_mode not in (None, "rgb_array"):
            raise ValueError(
                f"render_mode={render_mode!r} is not supported, expected 'rgb_array' or None: "
                "use 'rgb_array' and show the frames that render() returns"
            )
        self.layout = ring_layout(representation)
        self.layout.control_groups(control)
        self.control = control
        self.map = representation_map(representation)
        self.generator = RingGenerator(n_modes, mode_probabilities, mode_angles, path_spread)
        self.partition = RingPartition(n_modes, mode_angles, tau)
        #: The arguments, as JSON, with which the same task can be made again.
        self.settings: dict[str, Any] = {
            "representation": representation,
            "control": control,
            "mode_probabilities": None if mode_probabilities is None else list(self.generator.probabilities),
            "mode_angles": None if mode_angles is None else list(self.generator.angles),
            "path_spread": self.generator.path_spread,
            "tau": self.partition.tau,
        }
        self.description = f"Go out to one of the {n_modes} modes of the ring and come back."

    def decode(self, action: ArrayLike) -> np.ndarray:
        """Positions (..., 2) in metres that ``action`` (..., width of the control) commands.

        Raises:
            ValueError: If the shape is wrong or a number is not finite.
        """
        values = np.asarray(action, dtype=np.float64)
        width = self.map.width if self.control == "joint" else 2
        if values.ndim == 0 or values.shape[-1] != width or not np.isfinite(values).all():
            found = f"shape {values.shape}" if values.shape[-1:] != (width,) else "NaN or infinite numbers"
            raise ValueError(
                f"the action has {found}, expected {width} finite numbers in the last axis for "
                f"control={self.control!r} of layout {self.layout.name}: check what the policy returned"
            )
        return self.map.to_position(values) if self.control == "joint" else values

    def restored_condition(self, options: Mapping[str, Any] | None) -> np.ndarray | None:
        """The condition (..., 3) that ``reset(options=...)`` asks for, or None for a random one.

        ``options["state"]`` is ``{"environment_state": (cos theta, sin theta, r)}`` as observed and recorded,
        or ``{"theta": rad, "r": m}``.

        Raises:
            ValueError: If an option or an entry of the state is unknown, missing or out of range.
        """
        if unknown := set(options or {}) - RESET_OPTIONS:
            raise ValueError(f"reset option {sorted(unknown)} is unknown, expected 'state': remove or rename it")
        state = (options or {}).get("state")
        if state is None:
            return None
        if isinstance(state, Mapping) and set(state) == {"environment_state"}:
            condition = geometry.validated_condition(state["environment_state"])
        elif isinstance(state, Mapping) and set(state) == {"theta", "r"}:
            condition = geometry.validated_condition(geometry.condition_vector(state["theta"], state["r"]))
        else:
            found = sorted(state) if isinstance(state, Mapping) else type(state).__name__
            raise ValueError(
                f"options['state'] has {found}, expected a dictionary with 'environment_state', or with "
                "'theta' and 'r': pass the environment_state of the recorded first frame"
            )
        low, high = np.asarray(geometry.RADIUS_RANGE, dtype=np.float32)
        radius = condition[..., 2].astype(np.float32)
        if not ((radius >= low) & (radius <= high)).all():
            raise ValueError(f"options['state'] has radius {radius.tolist()}, expected 0.7 to 1.3 m: check its unit")
        return condition

    def inside_arena(self, position: np.ndarray) -> np.ndarray:
        """Whether ``position`` (..., 2) lies in the arena."""
        return (np.abs(position) <= ARENA).all(axis=-1)
