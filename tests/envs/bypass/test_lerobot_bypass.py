"""The bypass environments as LeRobot makes and drives them."""

import subprocess
import sys

import gymnasium as gym
import pytest
import torch
from lerobot.envs.factory import make_env, make_env_config, make_env_pre_post_processors
from lerobot.envs.utils import env_to_policy_features
from lerobot.scripts.lerobot_eval import rollout

import dualhead_envs.lerobot_envs  # noqa: F401  (registers the choices)
from dualhead_envs.bypass.demonstrations import demonstrate_modes

TYPES = {"bimodal_bypass": "BimodalBypass-v2", "rotating_bypass": "RotatingBypass-v3"}


class Replay(torch.nn.Module):
    """Returns a demonstration's dual actions, one step after the other, to every environment of the batch."""

    def __init__(self, actions):
        super().__init__()
        self.actions = torch.from_numpy(actions)
        self.reset()

    def reset(self):
        self.step = 0

    def select_action(self, batch):
        action = self.actions[min(self.step, len(self.actions) - 1)]
        self.step += 1
        return action.expand(len(batch["observation.state"]), -1)


@pytest.fixture(scope="module", params=sorted(TYPES))
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def actions(kind):
    expert = gym.make(f"dualhead_envs:{TYPES[kind]}", control="pose").unwrapped
    return demonstrate_modes(expert, seed=9).demonstrations[0].actions()


def roll_out(config, actions, use_async_envs=False, n_envs=1):
    env = make_env(config, n_envs=n_envs, use_async_envs=use_async_envs)[config.type][0]
    try:
        before, after = make_env_pre_post_processors(config, None)
        unchanged = lambda x: x  # noqa: E731
        return rollout(env, Replay(actions), before, after, unchanged, unchanged, seeds=[9] * n_envs)
    finally:
        env.close()


@pytest.mark.parametrize("control", ["joint", "position", "pose"])
def test_one_dual_action_vector_succeeds_under_every_control(kind, actions, control):
    result = roll_out(make_env_config(kind, control=control), actions)
    assert result["success"].any()
    width = {"joint": 8, "position": 4, "pose": 10}[control]
    assert result["action"].shape[-1] == width


def test_a_perturbation_reaches_the_environment(kind):
    env = make_env(make_env_config(kind, perturbation="joint_bias@2"), n_envs=1)[kind][0]
    assert env.envs[0].unwrapped._perturbed.name.startswith("joint_bias:")
    env.close()


@pytest.mark.slow
def test_asynchronous_workers_do_the_same(kind, actions):
    config = make_env_config(kind)
    together = roll_out(config, actions[:20], n_envs=2)
    apart = roll_out(config, actions[:20], n_envs=2, use_async_envs=True)
    for key in ("action", "reward", "success"):
        torch.testing.assert_close(together[key], apart[key], rtol=0, atol=0)


def test_policies_see_the_dual_action_vector(kind):
    features = env_to_policy_features(make_env_config(kind))
    widths = {"bimodal_bypass": 18, "rotating_bypass": 21}
    assert {key: feature.shape for key, feature in features.items()} == {
        "observation.state": (24,),
        "observation.environment_state": (widths[kind],),
        "action": (17,),
    }


def test_bad_settings_are_refused_where_they_are_made(kind):
    for settings, words in (
        ({"control": "velocity"}, "control='velocity'"),
        ({"tau": -1.0}, "env.tau"),
        ({"image_size": 0}, "env.image_size"),
        ({"perturbation": "wind:3"}, "no known kind"),
        ({"task": "RotatingRing-v2"}, "contradicts"),
    ):
        with pytest.raises(ValueError, match=words):
            make_env_config(kind, **settings)


def test_the_configurations_load_no_simulator():
    code = (
        "import sys, dualhead_envs.lerobot_envs\n"
        "assert not {'mujoco', 'robosuite', 'OpenGL', 'numba'} & set(sys.modules), sorted(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
