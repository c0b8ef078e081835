"""Folders of LeRobot's other policies: opened as they were saved, refused where they would run or fetch more."""

from __future__ import annotations

import json
import shutil

import pytest
import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.policies import make_pre_post_processors
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.vqbet.configuration_vqbet import VQBeTConfig
from lerobot.policies.vqbet.modeling_vqbet import VQBeTPolicy
from safetensors.torch import load_file, save_file

from dualhead_policy.lerobot_policies.chunks import ChunkPolicy
from dualhead_policy.lerobot_policies.opening import open_lerobot_policy
from dualhead_policy.pretrained import policy_folder

STATE = {
    "observation.state": PolicyFeature(FeatureType.STATE, (2,)),
    "observation.environment_state": PolicyFeature(FeatureType.ENV, (3,)),
}
ACTION = {"action": PolicyFeature(FeatureType.ACTION, (4,))}
SMALL = {"chunk_size": 6, "n_action_steps": 3, "dim_model": 16, "n_heads": 2, "dim_feedforward": 16, "latent_dim": 2}


def saved(policy, folder):
    """A folder as lerobot-train leaves it."""
    features = {**policy.config.input_features, **policy.config.output_features}
    statistics = {
        key: {name: torch.full(feature.shape, value) for name, value in (("mean", 0.5), ("std", 2.0))}
        | {"min": torch.full(feature.shape, -1.0), "max": torch.full(feature.shape, 1.0)}
        for key, feature in features.items()
    }
    for processor in make_pre_post_processors(policy.config, dataset_stats=statistics):
        processor.save_pretrained(folder)
    policy.save_pretrained(folder)
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    config = ACTConfig(input_features=STATE, output_features=ACTION, device="cpu", n_vae_encoder_layers=1, **SMALL)
    return saved(ACTPolicy(config), tmp_path_factory.mktemp("policies") / "act")


@pytest.fixture
def folder(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "act")


def edit(path, change):
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def observed(policy, rows=2):
    generator = torch.Generator().manual_seed(0)
    shapes = policy.observation_shapes
    return {key: torch.rand(rows, policy.n_obs_steps, *shape, generator=generator) for key, shape in shapes.items()}


def test_a_folder_opens_to_the_policy_that_was_saved(whole):
    policy = open_lerobot_policy(whole)
    theirs = ACTPolicy.from_pretrained(whole)
    history = observed(policy)
    pre, post = make_pre_post_processors(theirs.config, pretrained_path=str(whole))
    chunk = post(theirs.predict_action_chunk(pre({key: value[:, 0] for key, value in history.items()})))
    assert torch.allclose(policy.draw(history, 2, seed=0)[:, 1], chunk, atol=1e-6)
    assert (policy.name, policy.action_width, policy.executed_steps, policy.denoising_steps) == ("act", 4, 3, 1)


def test_the_process_keeps_its_own_random_numbers(whole):
    policy = open_lerobot_policy(whole)
    torch.manual_seed(1)
    expected = torch.rand(3)
    torch.manual_seed(1)
    policy.draw(observed(policy), 2, seed=5)
    assert (torch.rand(3) == expected).all()


def test_a_policy_of_images_and_a_past_is_drawn_from(tmp_path):
    features = {"observation.state": STATE["observation.state"]}
    features["observation.image"] = PolicyFeature(FeatureType.VISUAL, (3, 64, 64))
    sizes = {"gpt_n_layer": 1, "gpt_n_head": 2, "gpt_input_dim": 16, "gpt_output_dim": 16, "gpt_hidden_dim": 16}
    config = VQBeTConfig(
        input_features=features, output_features=ACTION, device="cpu", n_obs_steps=3, crop_shape=None,
        pretrained_backbone_weights=None, vqvae_n_embed=4, vqvae_embedding_dim=8, bet_softmax_temperature=5.0, **sizes,
    )  # fmt: skip
    policy = open_lerobot_policy(saved(VQBeTPolicy(config), tmp_path / "vqbet"))
    history = observed(policy)
    chunks = policy.draw(history, 8, seed=0)
    assert chunks.shape == (2, 8, 5, 4)
    assert (chunks == policy.draw(history, 8, seed=0)).all()
    assert not torch.equal(chunks, policy.draw(history, 8, seed=1))
    assert len(chunks[0].unique(dim=0)) > 1


def test_a_policy_that_averages_chunks_is_refused(whole):
    config = ACTConfig(
        input_features=STATE, output_features=ACTION, device="cpu", n_vae_encoder_layers=1,
        **(SMALL | {"n_action_steps": 1}), temporal_ensemble_coeff=0.01,
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"temporal_ensemble_coeff=0\.01"):
        ChunkPolicy(ACTPolicy(config), dict, dict)


def test_a_repository_on_the_hub_is_found_in_the_downloads(whole, tmp_path, monkeypatch):
    # The cache as huggingface_hub leaves it; offline, the name resolves there.
    repository = tmp_path / "hub" / "models--somebody--act"
    snapshot = repository / "snapshots" / "0123456789abcdef0123456789abcdef01234567"
    shutil.copytree(whole, snapshot)
    (repository / "refs").mkdir()
    (repository / "refs" / "main").write_text(snapshot.name)
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    found = policy_folder("somebody/act")
    assert found == snapshot
    assert open_lerobot_policy(found).name == "act"
    with pytest.raises(FileNotFoundError, match="neither a folder here nor a policy on the hub"):
        policy_folder("somebody/else")


@pytest.mark.parametrize(
    "step",
    [
        {"class": "subprocess.Popen", "config": {"args": ["touch", "it-ran"]}},
        {"registry_name": "normalizer_processor", "class": "os.system", "config": {"command": "touch it-ran"}},
        {"registry_name": "tokenizer_processor", "config": {"tokenizer_name": "somebody/code"}},
        {"registry_name": "reward_classifier_processor", "config": {"pretrained_path": "/"}},
    ],
)
def test_a_step_that_could_run_or_fetch_anything_is_refused(folder, tmp_path, monkeypatch, step):
    monkeypatch.chdir(tmp_path)
    edit(folder / "policy_preprocessor.json", lambda content: content["steps"].append(step))
    with pytest.raises(ValueError, match="policy_preprocessor"):
        open_lerobot_policy(folder)
    assert not (tmp_path / "it-ran").exists()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("type", "groot"),
        ("type", 3),
        ("dim_model", 10**9),
        ("dim_model", 8192),  # no allocation either: the weights are of another size
        ("n_encoder_layers", 10**6),
        ("dim_model", "sixteen"),
        ("stranger", 1),
        ("use_peft", True),
        ("input_features", {"observation.state": {"type": "STATE", "shape": [10**9]}}),
        ("output_features", {}),
        ("n_heads", 3),
    ],
)
def test_a_configuration_that_is_none_or_of_other_weights_is_refused(folder, field, value):
    edit(folder / "config.json", lambda content: content.update({field: value}))
    with pytest.raises(ValueError, match=r"config\.json|model\.safetensors") as refusal:
        open_lerobot_policy(folder)
    assert str(refusal.value).isprintable()


def test_weights_that_are_damaged_or_not_finite_are_refused(folder):
    weights = load_file(folder / "model.safetensors")
    name = "model.action_head.weight"
    save_file(weights | {name: torch.full_like(weights[name], torch.nan)}, folder / "model.safetensors")
    with pytest.raises(ValueError, match="has non-finite tensors"):
        open_lerobot_policy(folder)
    (folder / "model.safetensors").write_bytes((folder / "model.safetensors").read_bytes()[:1000])
    with pytest.raises(ValueError, match="may be truncated"):
        open_lerobot_policy(folder)


def test_statistics_that_are_not_finite_and_links_out_of_the_folder_are_refused(folder, tmp_path):
    file = next(folder.glob("policy_preprocessor*normalizer*.safetensors"))
    state = load_file(file)
    state["observation.state.mean"][0] = torch.inf
    save_file(state, file)
    with pytest.raises(ValueError, match="not finite"):
        open_lerobot_policy(folder)
    (tmp_path / "elsewhere").write_bytes(file.read_bytes())
    file.unlink()
    file.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match="link that leaves its folder"):
        open_lerobot_policy(folder)


def test_normalisation_is_the_folders_own(whole):
    """ACT's default maps actions by mean and deviation; the postprocessor brings them back."""
    policy = open_lerobot_policy(whole)
    assert policy.policy.config.normalization_mapping["ACTION"] is NormalizationMode.MEAN_STD
    assert torch.allclose(policy.postprocess(torch.zeros(1, 4)), torch.full((1, 4), 0.5))
