"""A policy's folder from somebody else: it runs nothing, reads nothing outside itself, and exhausts nothing."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.pretrained import load_policy, policy_folder

NORMALIZER = "policy_preprocessor_step_3_normalizer_processor.safetensors"


@pytest.fixture
def folder(trained, tmp_path):
    return shutil.copytree(policy_folder(trained), tmp_path / "policy")


def edit(path: Path, change) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def test_a_whole_folder_loads_as_it_was_saved(folder, ring_data):
    policy, preprocess = load_policy(folder)
    stats = load_file(folder / NORMALIZER)
    batch = {key: torch.zeros(1, *policy.config.input_features[key].shape) for key in policy.observation_keys}
    normalized = preprocess(batch)
    for key in policy.observation_keys:
        assert torch.allclose(normalized[key], -stats[f"{key}.mean"] / (stats[f"{key}.std"] + 1e-8))


@pytest.mark.parametrize("file", ["policy_preprocessor.json", "policy_postprocessor.json"])
@pytest.mark.parametrize("where", [0, -1])
def test_a_folder_that_names_a_foreign_step_runs_nothing(folder, tmp_path, file, where):
    witness = tmp_path / "it ran"
    step = {"class": "subprocess.Popen", "config": {"args": ["touch", str(witness)]}}
    edit(folder / file, lambda content: content["steps"].insert(where, step))
    with pytest.raises(ValueError, match=file) as refusal:
        load_policy(folder)
    assert "\n" not in str(refusal.value)
    assert not witness.exists()


@pytest.mark.parametrize(
    "step",
    [
        {"class": "builtins.dict", "config": {}},
        {"registry_name": "tokenizer_processor", "config": {"tokenizer_name": "somebody/else"}},
        {"registry_name": "to_batch_processor", "class": "subprocess.Popen", "config": {}},
    ],
)
def test_only_our_own_steps_are_accepted(folder, step):
    edit(folder / "policy_preprocessor.json", lambda content: content["steps"].__setitem__(1, step))
    with pytest.raises(
        ValueError, match=r"policy_preprocessor\.json has an? .*steps|policy_preprocessor\.json .*steps"
    ):
        load_policy(folder)


@pytest.mark.parametrize("name", ["/etc/hostname", "../policy.safetensors", "model.safetensors/../x", ".."])
def test_a_state_file_outside_the_folder_is_refused(folder, name):
    edit(folder / "policy_preprocessor.json", lambda content: content["steps"][3].update(state_file=name))
    with pytest.raises(ValueError, match="names a file outside itself"):
        load_policy(folder)


@pytest.mark.parametrize("name", ["config.json", "model.safetensors", "policy_preprocessor.json", NORMALIZER])
def test_a_link_that_leaves_the_folder_is_refused_and_its_content_stays_secret(folder, tmp_path, name):
    secret = tmp_path / "secret"
    secret.write_text("the combination of the safe")
    (folder / name).unlink()
    (folder / name).symlink_to(secret)
    with pytest.raises(ValueError, match="link that leaves its folder") as refusal:
        load_policy(folder)
    assert "combination" not in str(refusal.value)


def test_a_downloads_cache_loads_although_it_is_made_of_links(folder, tmp_path):
    snapshot, blobs = tmp_path / "snapshots" / "abc", tmp_path / "blobs"
    snapshot.mkdir(parents=True)
    blobs.mkdir()
    for file in folder.iterdir():
        shutil.copy(file, blobs / file.name)
        (snapshot / file.name).symlink_to(os.path.relpath(blobs / file.name, snapshot))
    load_policy(snapshot)


@pytest.mark.parametrize("damage", ["left out", "without its state", "infinite", "zero", "nan", "short", "emptied"])
def test_a_normaliser_that_would_make_nonsense_is_refused(folder, damage):
    if damage == "left out":
        edit(folder / "policy_preprocessor.json", lambda content: content["steps"].pop())
    elif damage == "without its state":
        edit(folder / "policy_preprocessor.json", lambda content: content["steps"][3].pop("state_file"))
    else:
        state = load_file(folder / NORMALIZER)
        name = "observation.environment_state.std"
        values = {"infinite": torch.inf, "zero": 0.0, "nan": torch.nan}
        if damage in values:
            state[name][0] = values[damage]
        elif damage == "short":
            state[name] = state[name][:1].clone()
        else:
            del state[name]
        save_file(state, folder / NORMALIZER)
    with pytest.raises(ValueError, match="load the folder that the policy was saved to") as refusal:
        load_policy(folder)
    assert "\n" not in str(refusal.value)


def test_a_normaliser_of_another_kind_than_the_configuration_says_is_refused(folder):
    edit(
        folder / "policy_preprocessor.json",
        lambda content: content["steps"][3]["config"]["norm_map"].update(ENV="IDENTITY"),
    )
    with pytest.raises(ValueError, match=r"normalises by .*IDENTITY"):
        load_policy(folder)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("velocity_width", 10**9),
        ("velocity_layers", 10**6),
        ("encoder_dim", 10**9),
        ("chunk_size", 10**9),
        ("time_frequencies", 10**8),
        ("n_tokens", 10**9),
        ("num_inference_steps", 10**9),
        ("velocity_width", 16_384),
        ("velocity_width", "256"),
        ("velocity_width", 256.5),
        ("kl_weight", 1e999),
        ("input_features", {"observation.state": {"type": "STATE", "shape": [10**9]}}),
        ("environment", "\x1b[2J"),
        ("representation", None),
        ("device", None),
    ],
)
def test_a_configuration_beyond_reason_is_refused_before_anything_is_allocated(folder, field, value):
    edit(folder / "config.json", lambda content: content.update({field: value}))
    if field == "device":
        load_policy(folder)  # the caller chooses the device
        return
    with pytest.raises(ValueError, match=f"{field}|not JSON|number of JSON") as refusal:
        load_policy(folder)
    assert str(refusal.value).isprintable()


@pytest.mark.parametrize("text", ["[" * 100_000, '{"type": "dualhead"', '{"a": NaN}', '{"a": 1, "a": 2}', "", "\x00"])
def test_a_configuration_that_is_no_json_is_refused(folder, text):
    (folder / "config.json").write_text(text)
    with pytest.raises(ValueError, match=r"config\.json"):
        load_policy(folder)


def urdf(length: float) -> str:
    return f"""<robot name="one"><link name="base"/><link name="arm"/><link name="tip"/>
    <joint name="a" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
    <joint name="b" type="fixed"><origin xyz="{length} 0 0"/><parent link="arm"/><child link="tip"/></joint></robot>"""


def test_two_robots_under_one_name_keep_their_own_kinematics(tmp_path):
    reach = {}
    for name, length in (("short", 1.0), ("long", 2.0)):
        description = tmp_path / "robot.urdf"
        description.write_text(urdf(length))
        (tmp_path / name).mkdir()
        KinematicMap(f"file:{description}#tip").save(tmp_path / name)
    description.unlink()
    maps = {name: KinematicMap.load(f"file:{description}#tip", tmp_path / name) for name in ("short", "long")}
    for name, loaded in maps.items():
        reach[name] = loaded.position(torch.zeros(1, 1)).norm().item()
    assert reach == pytest.approx({"short": 1.0, "long": 2.0})


def test_a_carried_robot_is_read_from_its_folder_alone(tmp_path):
    secret = tmp_path / "secret.urdf"
    secret.write_text(urdf(1.0))
    (tmp_path / "policy").mkdir()
    with pytest.raises(FileNotFoundError, match=r"robot\.json is missing"):
        KinematicMap.load(f"file:{secret}#tip", tmp_path / "policy")
    (tmp_path / "policy" / "robot.json").symlink_to(secret)
    with pytest.raises(ValueError, match="link that leaves its folder"):
        KinematicMap.load(f"file:{secret}#tip", tmp_path / "policy")
