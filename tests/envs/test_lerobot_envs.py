"""The LeRobot environment of the ring, made and rolled out by LeRobot's own code."""

import json
import subprocess
import sys

import draccus
import numpy as np
import pytest
import torch
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env, make_env_config, make_env_pre_post_processors
from lerobot.envs.utils import env_to_policy_features
from lerobot.scripts.lerobot_eval import rollout

import dualhead_envs.lerobot_envs  # noqa: F401  (registers the choices)
from dualhead_envs.ring.generator import RingGenerator
from dualhead_envs.ring.maps import representation_map


class ScriptedPolicy(torch.nn.Module):
    """The expert behind LeRobot's policy interface: returns the dual action vector."""

    def __init__(self, config):
        super().__init__()
        self.generator = RingGenerator(config.n_modes)
        self.map = representation_map(config.representation)
        self.reset()

    def reset(self):
        self.step = 0

    def select_action(self, batch):
        condition = batch["observation.environment_state"].numpy()
        if self.step == 0:
            rng = np.random.default_rng(0)
            self.path = self.generator.draw_paths(rng, condition, self.generator.draw_modes(rng, len(condition)))
        point = self.path[:, self.step]
        self.step += 1
        assert len(batch["task"]) == len(condition)
        return torch.from_numpy(np.concatenate([self.map.from_position(point), point], axis=-1)).float()


def roll_out(config, use_async_envs=False):
    env = make_env(config, n_envs=3, use_async_envs=use_async_envs)["rotating_ring"][0]
    try:
        before, after = make_env_pre_post_processors(config, None)
        unchanged = lambda x: x  # noqa: E731
        return rollout(env, ScriptedPolicy(config), before, after, unchanged, unchanged, seeds=[4, 5, 6])
    finally:
        env.close()


@pytest.mark.parametrize("representation", ["orthogonal", "polar", "nullspace"])
@pytest.mark.parametrize("control", ["joint", "position"])
def test_one_policy_works_under_every_control(representation, control):
    config = make_env_config("rotating_ring", n_modes=4, representation=representation, control=control)
    result = roll_out(config)
    assert result["success"].any(dim=1).all()
    width = representation_map(representation).width if control == "joint" else 2
    assert result["action"].shape == (3, 16, width)


@pytest.mark.slow
def test_workers_that_start_with_an_empty_registry_do_the_same():
    config = make_env_config("rotating_ring", n_modes=3, representation="polar")
    together, apart = roll_out(config), roll_out(config, use_async_envs=True)
    for key in ("action", "reward", "success"):
        torch.testing.assert_close(together[key], apart[key], rtol=0, atol=0)


def test_policies_see_the_dual_action_vector_and_its_layout():
    features = env_to_policy_features(make_env_config("rotating_ring", representation="nullspace"))
    assert {key: feature.shape for key, feature in features.items()} == {
        "observation.state": (2,),
        "observation.environment_state": (3,),
        "action": (8,),
    }
    assert features["action"].layout_name == "ring/nullspace"


def test_the_configuration_survives_a_file():
    config = make_env_config("rotating_ring", n_modes=3, mode_probabilities=[0.5, 0.3, 0.2], tau=0.6)
    with draccus.config_type("json"):
        written = draccus.dump(config)
        read = draccus.decode(EnvConfig, json.loads(written) | {"type": "rotating_ring"})
    assert read.gym_kwargs == config.gym_kwargs
    assert read.features["action"].layout_name == "ring/orthogonal"


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"n_modes": 5}, r"env.n_modes=5 has no environment, expected one of \[2, 3, 4, 8\]"),
        ({"task": "RotatingRing-v4"}, "set env.n_modes alone"),
        ({"representation": "cartesian"}, "representation='cartesian'"),
        ({"control": "pose"}, "control='pose'"),
        ({"render_mode": "human"}, "render_mode='human'"),
        ({"mode_probabilities": [0.5, 0.4]}, "sum to 1"),
    ],
)
def test_bad_fields_are_refused_before_anything_is_made(fields, message):
    with pytest.raises(ValueError, match=message):
        make_env_config("rotating_ring", **fields)


def test_actions_of_another_layout_are_refused_with_a_sentence():
    config = make_env_config("rotating_ring", representation="polar")
    _, after = make_env_pre_post_processors(config, None)
    with pytest.raises(ValueError, match="width 8, expected the 4 dimensions of layout ring/polar"):
        after({"action": torch.zeros(3, 8)})


def test_lerobot_finds_the_choice_by_the_name_of_the_distribution(tmp_path):
    code = (
        "from lerobot.utils.import_utils import register_third_party_plugins\n"
        "register_third_party_plugins()\n"
        "from lerobot.envs.factory import make_env_config; print(make_env_config('rotating_ring').task)"
    )
    run = {"cwd": tmp_path, "capture_output": True, "text": True, "check": True}
    answer = subprocess.run([sys.executable, "-c", code], **run)
    assert answer.stdout.split()[-1] == "RotatingRing-v2"
