"""What the two bypass environments share: the episode, its observations, its states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np

from dualhead_envs.bypass.controllers import make_control
from dualhead_envs.bypass.initial_state import InitialState
from dualhead_envs.bypass.outcome import CubeFate
from dualhead_envs.bypass.partition import BypassPartition
from dualhead_envs.bypass.perturbations.episode import PerturbedEpisode
from dualhead_envs.bypass.perturbations.perturbation import parse_perturbation
from dualhead_envs.bypass.simulation import PandaSimulation, observed_positions
from dualhead_envs.bypass.task import BypassTask
from dualhead_envs.layout import Layout
from dualhead_envs.ribbon import Ribbon

#: Steps after which an episode is truncated; a demonstration takes about 200.
MAX_EPISODE_STEPS = 300


class BypassEnv(gym.Env):
    """Base of :class:`BimodalBypassEnv` and :class:`RotatingBypassEnv`, which hold the documentation."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012  (Gymnasium's own convention)
    bypass: BypassTask
    layout: ClassVar[Layout]
    task_description: str
    #: How far aside (m) demonstrations shall go; None for the expert's own amplitude. No episode depends on it.
    demonstrated_amplitude: float | None = None

    def __init__(
        self,
        partition: BypassPartition,
        *,
        control: str = "joint",
        feed_forward: bool = True,
        pixels: bool = False,
        render_mode: str | None = None,
        camera: str | None = None,
        image_size: tuple[int, int] = (256, 256),
        perturbation: str | None = None,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode={render_mode!r} is not supported: choose 'rgb_array' or None")
        if len(image_size) != 2 or min(image_size) < 1:
            raise ValueError(f"image_size={image_size!r} should be (height, width) in pixels, for example (256, 256)")
        self.control = control
        self.action_space = self.layout.action_space(control)  # refuses a control that does not exist
        self.observation_space = self.layout.observation_space()
        self.mode_partition = partition
        self.render_mode = render_mode
        self._pixels = pixels
        self._camera = camera
        self._image_size = (int(image_size[0]), int(image_size[1]))
        if pixels:
            box = gym.spaces.Box(0, 255, (*self._image_size, 3), np.uint8)
            self.observation_space = gym.spaces.Dict({**self.observation_space.spaces, "pixels": box})
        env_id = self.bypass.env_id
        perturbed = None if perturbation is None else parse_perturbation(perturbation, env_id)
        if perturbed is not None and perturbed.kind == "obstacle" and not self.bypass.has_obstacle:
            raise ValueError(
                f"perturbation={perturbation!r} moves an obstacle that is not there: choose another kind, or make the "
                "environment with its obstacle"
            )
        self._arguments = {
            "control": control, "feed_forward": feed_forward, "pixels": pixels, "render_mode": render_mode,
            "camera": camera, "image_size": self._image_size, "tau": partition.tau,
            "perturbation": perturbation,
        }  # fmt: skip
        # What lerobot-eval asks of an environment.
        self.task = env_id
        self._max_episode_steps = MAX_EPISODE_STEPS
        self._control = make_control(control, feed_forward=feed_forward)
        self.simulation = PandaSimulation(self.bypass, self._control.form)
        self._perturbed = PerturbedEpisode(perturbed, self.simulation)
        self._fate = CubeFate()
        self._steps = 0
        self._renderer: Any = None
        self._initial: InitialState | None = None
        self._context: np.ndarray = np.empty(0)
        self._label = -1
        self._strength = 0.0
        self._ended = True

    # A MuJoCo model does not pickle small; the arguments do. The copy starts before its first reset.
    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (type(self), self._arguments)

    @property
    def initial_state(self) -> InitialState:
        """How this episode began.

        Raises:
            gymnasium.error.ResetNeeded: Before the first reset.
        """
        if self._initial is None:
            raise gym.error.ResetNeeded("there is no episode yet: call reset()")
        return self._initial

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode at a random or restored state; see the class docstring.

        Raises:
            ValueError: If ``options`` holds anything but a valid ``state`` of this environment.
        """
        super().reset(seed=seed)
        # LeRobot marks its resets with options of its own.
        options = {key: value for key, value in (options or {}).items() if not key.startswith("lerobot_")}
        state = options.pop("state", None)
        if options:
            raise ValueError(f"reset options {sorted(options)} do not exist: the only option is 'state'")
        self._label, self._strength = -1, 0.0
        if state is None:
            self._begin(InitialState.draw(self.bypass, self.np_random))
        else:
            self._restore(state)
        self._ended = False
        self._follow_mode()
        return self._observation(), self._info(is_success=False)

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Execute ``action`` for one control step of 50 ms.

        Raises:
            ValueError: If the action has the wrong shape or holds a number that is not finite.
            gymnasium.error.ResetNeeded: If the episode has ended or never begun.
        """
        if self._ended:
            raise gym.error.ResetNeeded("the episode has ended or never begun: call reset() before step()")
        given = self._checked(action)
        self._control.step(self.simulation, self._perturbed.act(given, self._steps))
        self._steps += 1
        self._perturbed.follow(self._steps)
        self._fate.follow(self.simulation, given[-1])
        self._follow_mode()
        is_success = not self.simulation.touched and self.simulation.cube_at_goal()
        terminated = is_success or self.simulation.touched
        self._ended = terminated
        return self._observation(), float(is_success), terminated, False, self._info(is_success)

    def state(self) -> dict[str, Any]:
        """Everything that the rest of the episode depends on, for ``reset(options={"state": ...})``.

        Under the same control the episode continues bit for bit. Under another the physics are the same and the
        control starts anew.
        """
        initial = self.initial_state
        return {
            "env_id": self.bypass.env_id,
            "obstacle": self.bypass.has_obstacle,
            "control": self.control,
            "physics": self.simulation.snapshot(),
            "memory": self._control.memory(),
            "initial": initial.numbers(),
            "mode": np.array([self._label, self._strength]),
            "progress": np.append(self._steps, self._fate.memory()),
            "perturbation": self._perturbed.state(),
        }

    def render(self) -> np.ndarray | None:
        """The scene: RGB (height, width, 3) uint8, or None without render_mode.

        Raises:
            RuntimeError: If no OpenGL library can be used; the sentence says what to install.
            gymnasium.error.ResetNeeded: If there is no episode to show.
        """
        if self.render_mode is None:
            gym.logger.warn("render() was called without a render_mode: pass render_mode='rgb_array' to gym.make")
            return None
        return self.picture()

    def picture(self, ribbons: Sequence[Ribbon] = ()) -> np.ndarray:
        """What :meth:`render` shows, under any render_mode, with predicted paths (H, 3) of the grip site drawn too.

        Raises:
            RuntimeError: If no OpenGL library can be used; the sentence says what to install.
            ValueError: If a ribbon has another shape.
            gymnasium.error.ResetNeeded: If there is no episode to show.
        """
        if self._initial is None:
            raise gym.error.ResetNeeded("there is no episode to show: call reset() before render()")
        simulation = self.simulation
        return self._scene().render(simulation.data.qpos, simulation.obstacle_position, simulation.goal, ribbons)

    def picture_of(self, observation: Mapping[str, np.ndarray], ribbons: Sequence[Ribbon] = ()) -> np.ndarray:
        """The scene that an observation describes, whatever the episode, with predicted paths (H, 3) drawn too.

        Raises:
            RuntimeError: If no OpenGL library can be used; the sentence says what to install.
            ValueError: If a ribbon has another shape.
        """
        agent, state = (np.asarray(observation[key], dtype=np.float64) for key in ("agent_pos", "environment_state"))
        return self._scene().render(observed_positions(agent, state), state[12:15], state[9:12], ribbons)

    def _scene(self) -> Any:
        if self._renderer is None:
            from dualhead_envs.bypass.rendering import SceneRenderer

            height, width = self._image_size
            self._renderer = SceneRenderer(self.bypass, width, height, self._camera)
        return self._renderer

    def close(self) -> None:
        """Give the OpenGL context back, if one was opened."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _begin(self, initial: InitialState, key: int | None = None) -> None:
        """Start the episode of ``initial`` and the perturbation's ``key``, which is drawn by default."""
        self._initial = initial
        self.simulation.reset(initial.cube_x, initial.cube_y, initial.cube_yaw)
        self._control.start(self.simulation)
        self._steps, self._fate = 0, CubeFate()
        self._perturbed.begin(self._perturbed.draw_key(self.np_random) if key is None else key, self._hold())
        task = self.bypass
        context = [*self.simulation.goal, *task.obstacle_center, *task.obstacle_half_size]
        if task.route_radius is not None:
            context += [initial.route_radius, np.cos(initial.phi), np.sin(initial.phi)]
        self._context = np.array(context)

    def _hold(self) -> np.ndarray:
        """The action of the present control that stays where the robot is."""
        simulation = self.simulation
        here = {
            "joint": simulation.joints, "position": simulation.position,
            "rotation": simulation.rotation[:, :2].T.ravel(), "gripper": np.zeros(1),
        }  # fmt: skip
        return np.concatenate([here[group] for group in self.layout.control_groups(self.control)])

    def _restore(self, state: Any) -> None:
        if not isinstance(state, Mapping):
            raise ValueError(
                f"options['state'] is a {type(state).__name__}, expected what env.unwrapped.state() returns, or "
                "{'environment_state': ...} of an episode's first frame"
            )
        if set(state) == {"environment_state"}:
            self._begin(InitialState.recorded(self.bypass, state["environment_state"]))
            return
        expected = {
            "env_id", "obstacle", "control", "physics", "memory", "initial", "mode", "progress", "perturbation",
        }  # fmt: skip
        if set(state) != expected:
            raise ValueError(
                f"options['state'] has the keys {sorted(state)}, expected {sorted(expected)} as env.unwrapped.state() "
                "returns, or environment_state alone"
            )
        if state["env_id"] != self.bypass.env_id:
            raise ValueError(
                f"options['state'] was recorded in {state['env_id']}, expected {self.bypass.env_id}: "
                f"restore it in an environment made as {state['env_id']}"
            )
        if bool(state["obstacle"]) != self.bypass.has_obstacle:
            there, here = ("with", "without") if state["obstacle"] else ("without", "with")
            raise ValueError(
                f"options['state'] was recorded {there} an obstacle, expected one {here}: restore it in an environment "
                "made with the same obstacle"
            )
        physics = np.asarray(state["physics"], dtype=np.float64)
        if physics.shape != (self.simulation.snapshot_size,) or not np.isfinite(physics).all():
            raise ValueError(
                f"options['state']['physics'] has shape {physics.shape}, expected {self.simulation.snapshot_size} "
                "finite numbers: record it anew with the installed version of MuJoCo"
            )
        if (mode := int(state["mode"][0])) >= self.mode_partition.n_modes:
            raise ValueError(
                f"options['state'] is on its way by mode {mode}, expected one of the {self.mode_partition.n_modes} of "
                f"{self.mode_partition.name}: restore it in an environment of as many ways"
            )
        key, memory = self._perturbed.checked(state["perturbation"])
        self._begin(InitialState(*(float(value) for value in state["initial"])), key)
        self._perturbed.recall(memory)
        self.simulation.restore(physics)
        self._steps = int(state["progress"][0])
        self._fate.recall(np.asarray(state["progress"][1:], dtype=np.float64))
        self._label, self._strength = int(state["mode"][0]), float(state["mode"][1])
        if state["control"] == self.control:
            self._control.recall(np.asarray(state["memory"], dtype=np.float64))
        else:
            self._control.start(self.simulation)

    def _checked(self, action: np.ndarray) -> np.ndarray:
        values = np.asarray(action, dtype=np.float64)
        shape = self.action_space.shape
        if values.shape != shape:
            groups = " + ".join(
                f"{len(self.layout.action[group])} {group}" for group in self.layout.control_groups(self.control)
            )
            raise ValueError(
                f"the action has shape {values.shape}, expected {shape} ({groups}) under control={self.control!r}: "
                "take these dimensions of the dual action vector with layout.control_indices(control)"
            )
        if not np.isfinite(values).all():
            where = int(np.flatnonzero(~np.isfinite(values))[0])
            raise ValueError(
                f"the action holds {values[where]} at index {where}, expected finite numbers: the policy has diverged"
            )
        return values

    def _follow_mode(self) -> None:
        # The partition's strength is a peak over the path: it can be followed one point at a time.
        label, strength = self.mode_partition.score_point(self.simulation.position, self._context)
        if strength > self._strength:
            self._label, self._strength = label, strength

    def _info(self, is_success: bool) -> dict[str, Any]:
        mode = self._label if self._strength >= self.mode_partition.tau else -1
        collision = self.simulation.touched
        failure = self._fate.failure(
            is_success=is_success, collision=collision, time_is_up=self._steps >= self._max_episode_steps
        )
        return {
            "is_success": is_success, "mode": mode, "collision": collision, "failure": failure,
            "onset": self._perturbed.onset,
        }  # fmt: skip

    def _observation(self) -> dict[str, np.ndarray]:
        simulation = self.simulation
        rotation, cube = simulation.rotation, simulation.cube_rotation
        observation = {
            "agent_pos": np.concatenate(
                [
                    simulation.joints, simulation.joint_velocities, simulation.position,
                    rotation[:, 0], rotation[:, 1], [simulation.opening],
                ],
                dtype=np.float32,
            ),
            "environment_state": np.concatenate(
                [simulation.cube_position, cube[:, 0], cube[:, 1], self._context], dtype=np.float32
            ),
        }  # fmt: skip
        self._perturbed.observe(observation["agent_pos"], observation["environment_state"], self._steps)
        if self._pixels:
            observation["pixels"] = self.picture()
        return observation


def _rebuild(cls: type[BypassEnv], arguments: dict[str, Any]) -> BypassEnv:
    return cls(**arguments)
