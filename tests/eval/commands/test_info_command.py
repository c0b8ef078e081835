"""``dualhead info`` names what is installed and registered, aligned or as JSON."""

import json
import re
import subprocess
import sys
from importlib.metadata import version

import gymnasium as gym
import pytest

import dualhead_envs  # noqa: F401
from dualhead_eval.cli import main


@pytest.fixture(scope="module")
def found():
    done = subprocess.run(
        [sys.executable, "-m", "dualhead_eval.cli", "info", "--json"], capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    return json.loads(done.stdout)


def test_versions_are_those_that_are_installed(found):
    for name in ("lerobot", "torch", "numpy", "mujoco"):
        assert found["versions"][name] == version(name)


def test_every_environment_that_is_named_can_be_made(found):
    ours = {name for name, spec in gym.registry.items() if "dualhead_envs" in str(spec.entry_point)}
    assert set(found["environments"]) == ours
    for name, steps in found["environments"].items():
        assert gym.spec(name).max_episode_steps == steps


def test_types_are_those_that_lerobot_finds_through_the_plugin(found):
    assert found["types"]["--policy.type"] == ["dualhead"]
    assert {"bimodal_bypass", "rotating_bypass", "rotating_ring"} <= set(found["types"]["--env.type"])
    assert "joint_bias" in found["types"]["--perturb"]
    assert "side" in found["types"]["--partition"]


def test_the_table_lines_up(found, capsys):
    assert main(["info"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.strip()]
    names = [*found["versions"], *(f"dualhead_envs:{name}" for name in found["environments"]), *found["types"]]
    found_at = [re.match(rf" ?{re.escape(name)} +", line) for name in names for line in lines]
    starts = [match.end() for match in found_at if match]
    assert len(starts) == len(names)
    assert len(set(starts)) == 1
