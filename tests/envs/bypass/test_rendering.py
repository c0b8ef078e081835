"""Pictures where OpenGL is, a sentence where it is not."""

import os
import subprocess
import sys

import numpy as np
import pytest

from dualhead_envs.bypass.rendering import _is_installed

PICTURES = """
import sys
import gymnasium as gym
import numpy as np
env = gym.make("dualhead_envs:RotatingBypass-v3", render_mode="rgb_array", pixels=True, image_size=(48, 64))
observation, _ = env.reset(seed=0)
assert observation["pixels"].shape == (48, 64, 3) and observation["pixels"].dtype == np.uint8
assert env.observation_space.contains(observation)
np.testing.assert_array_equal(env.render(), observation["pixels"])
assert observation["pixels"].std() > 20
action = np.append(observation["agent_pos"][:7] + 0.1, -1.0).astype(np.float32)
for _ in range(5):
    moved = env.step(action)[0]
assert (moved["pixels"] != observation["pixels"]).any()
aside = gym.make("dualhead_envs:RotatingBypass-v3", pixels=True, image_size=(48, 64), perturbation="obstacle:0.1")
assert (aside.reset(seed=0)[0]["pixels"] != observation["pixels"]).mean() > 0.01, "pictures show the moved obstacle"
"""
RIBBONS = """
import gymnasium as gym
import numpy as np
from dualhead_envs.ribbon import Ribbon
env = gym.make("dualhead_envs:BimodalBypass-v2", image_size=(120, 120)).unwrapped
observation, _ = env.reset(seed=0)
plain = env.picture()
def drawn(x, y, **options):
    path = np.linspace([x, y - 0.05, 0.85], [x, y + 0.05, 0.85], 8)
    picture = env.picture([Ribbon(path, (255, 0, 255), width=3.0, **options)]).astype(int)
    magenta = np.minimum(picture[..., 0], picture[..., 2]) - picture[..., 1] > 100
    return magenta.sum(), np.argwhere(magenta).mean(axis=0) if magenta.any() else None
in_front, at = drawn(0.2, 0.0)
assert in_front > 20
assert drawn(0.2, 0.0, beads=True)[0] > 10
assert drawn(0.0, 0.0)[0] == 0, "the wall hides what lies behind it"
right = drawn(0.2, 0.2)[1]
assert right[1] > at[1] + 10, "the robot's left is the picture's right"
np.testing.assert_array_equal(env.picture(), plain)
np.testing.assert_allclose(env.picture_of(observation).astype(int), plain, atol=3)
for bad in (np.zeros((5, 2)), np.zeros(3)):
    try:
        env.picture([Ribbon(bad, (0, 0, 0))])
    except ValueError as error:
        assert "expected (H, 3) in metres" in str(error)
    else:
        raise AssertionError("taken")
"""
SENTENCE = """
import gymnasium as gym
env = gym.make("dualhead_envs:BimodalBypass-v2", render_mode="rgb_array")
env.reset(seed=0)
env.step(env.action_space.sample())
try:
    env.render()
except RuntimeError as error:
    print(error)
"""
#: Hides every OpenGL library from the process, whatever the machine has.
HIDE = """
import ctypes
load = ctypes.CDLL.__init__
def refuse(self, name, *args, **kwargs):
    if name and ("EGL" in name or "OSMesa" in name):
        raise OSError(f"{name}: cannot open shared object file: No such file or directory")
    load(self, name, *args, **kwargs)
ctypes.CDLL.__init__ = refuse
"""


def run(code, **environment):
    inherited = {key: value for key, value in os.environ.items() if key not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=inherited | environment, check=True
    )


@pytest.mark.parametrize("backend", ["egl", "osmesa"])
def test_each_library_that_is_there_makes_pictures_and_exits_quietly(backend):
    if _is_installed(backend):
        assert run(PICTURES, MUJOCO_GL=backend).stderr == ""
        assert run(RIBBONS, MUJOCO_GL=backend).stderr == ""
    else:
        answer = run(SENTENCE, MUJOCO_GL=backend).stdout
        assert f"MUJOCO_GL={backend} asks for" in answer


@pytest.mark.parametrize(
    ("code", "environment", "words"),
    [
        (HIDE + SENTENCE, {}, "rendering needs EGL or OSMesa"),
        (HIDE + SENTENCE, {"MUJOCO_GL": "osmesa"}, "MUJOCO_GL=osmesa asks for libOSMesa"),
        (HIDE + SENTENCE, {"MUJOCO_GL": "egl"}, "MUJOCO_GL=egl asks for libEGL"),
        (SENTENCE, {"MUJOCO_GL": "disable"}, "MUJOCO_GL=disable forbids rendering"),
    ],
)
def test_without_a_library_one_sentence_says_what_to_install(code, environment, words):
    answer = run(code, **environment)
    assert words in answer.stdout
    assert "apt-get install" in answer.stdout
    assert "MUJOCO_GL" in answer.stdout
    assert len(answer.stdout.splitlines()) == 1
    assert answer.stderr == ""


def test_a_preview_is_a_sheet_or_says_that_it_is_a_plot(tmp_path):
    code = (
        "from dualhead_envs.bypass.preview import write_preview\n"
        f"print(write_preview('BimodalBypass-v2', {str(tmp_path / 'pair.png')!r}))"
    )
    answer = run(HIDE + code).stdout
    assert "not rendered" in answer
    import matplotlib.image

    picture = matplotlib.image.imread(tmp_path / "pair.png")
    assert picture.shape[0] > 200
    assert np.std(picture) > 0.05


def test_a_preview_of_another_kind_is_refused(tmp_path):
    from dualhead_envs.bypass.preview import write_preview

    with pytest.raises(ValueError, match=r"\.png .* \.gif"):
        write_preview("BimodalBypass-v2", tmp_path / "pair.mp4")
