"""What became of the cube: the reason for which an episode counts as a failure."""

from __future__ import annotations

import numpy as np

from dualhead_envs.bypass.simulation import PandaSimulation

#: Values of ``info["failure"]``.
FAILURES = ("none", "collision", "drop", "miss", "timeout")


class CubeFate:
    """The story of the cube so far.

    ``collision``  something touched the obstacle;
    ``drop``       the cube lies beside the goal, and had been lifted and not been let go;
    ``miss``       it lies there because the hand let it go, or time is up and it was never lifted;
    ``timeout``    time is up and the cube is still under way.

    A cube that is lifted again is under way again.
    """

    def __init__(self) -> None:
        self._lifted = self._released = False
        self._lies = "none"

    def follow(self, simulation: PandaSimulation, gripper: float) -> None:
        """Take note of the state after a control step whose gripper command was ``gripper`` (-1 open, 1 closed)."""
        if simulation.cube_lifted:
            self._lifted, self._released, self._lies = True, False, "none"
        if gripper < 0.0:
            self._released = True
        if self._lifted and self._lies == "none" and simulation.cube_rests:
            self._lies = "miss" if self._released else "drop"

    def failure(self, *, is_success: bool, collision: bool, time_is_up: bool) -> str:
        """One of :data:`FAILURES`, as if the episode ended now."""
        if is_success:
            return "none"
        if collision:
            return "collision"
        if self._lies != "none" or not time_is_up:
            return self._lies
        return "timeout" if self._lifted else "miss"

    def memory(self) -> np.ndarray:
        """Lifted, released, and how it lies (an index of :data:`FAILURES`)."""
        return np.array([self._lifted, self._released, FAILURES.index(self._lies)], dtype=np.float64)

    def recall(self, memory: np.ndarray) -> None:
        """Return to a memory."""
        self._lifted, self._released = bool(memory[0]), bool(memory[1])
        self._lies = FAILURES[int(memory[2])]
