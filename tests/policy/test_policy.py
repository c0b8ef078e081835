"""The policy: what it samples, what its folder holds, and what it refuses to load."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy
from safetensors.torch import load_file, save_file

from dualhead_envs.dataset_frames import read_split
from dualhead_policy import DualheadConfig, SamplingCoupling
from dualhead_policy.flow.keyed_random import keyed_generator
from dualhead_policy.pretrained import load_policy, policy_folder


@pytest.fixture(scope="module")
def policy_and_batch(trained, ring_data):
    policy, preprocess = load_policy(trained)
    conditions = read_split(ring_data / "test").conditions()
    return policy, preprocess({key: torch.from_numpy(v) for key, v in conditions.observation.items()})


@pytest.fixture
def copied(trained, tmp_path):
    """A copy of the checkpoint folder that a test may damage."""
    return shutil.copytree(policy_folder(trained), tmp_path / "policy")


def new_policy(root, **fields):
    meta = LeRobotDatasetMetadata("local/ring", root=root)
    return make_policy(DualheadConfig(device="cpu", **fields), ds_meta=meta)


def test_samples_have_the_documented_shapes_and_repeat_with_the_generator(policy_and_batch):
    policy, batch = policy_and_batch
    first = policy.sample(batch, 5, generator=keyed_generator(3))
    again = policy.sample(batch, 5, generator=keyed_generator(3))
    assert first.joint.shape == (12, 5, 16, 6)
    assert first.position.shape == (12, 5, 16, 2)
    assert first.token.shape == (12, 5)
    assert first.rotation is None
    assert torch.equal(first.joint, again.joint)
    assert torch.equal(first.position, again.position)


def test_the_caller_chooses_noise_and_tokens(policy_and_batch):
    policy, batch = policy_and_batch
    noise = {"joint": torch.randn(12, 2, 16, 6), "position": torch.randn(12, 2, 16, 2)}
    zeros, ones = torch.zeros(12, 2, dtype=torch.int64), torch.ones(12, 2, dtype=torch.int64)
    same = [policy.sample(batch, 2, coupling=SamplingCoupling(source_noise=noise, token=zeros)) for _ in range(2)]
    other = policy.sample(batch, 2, coupling=SamplingCoupling(source_noise=noise, token=ones))
    assert torch.equal(same[0].joint, same[1].joint)
    assert not torch.allclose(same[0].joint, other.joint)
    redrawn = policy.sample(
        batch,
        2,
        coupling=SamplingCoupling(source_noise=noise, token=zeros, share_token=False),
        generator=keyed_generator(0),
    )
    assert torch.equal(redrawn.joint, same[0].joint)
    assert not torch.equal(redrawn.position, same[0].position)


def test_a_learned_prior_is_the_samplers_alone(ring_data, policy_and_batch):
    """What the token's prior learned decides which tokens are drawn, and nothing of what the heads make of them."""
    policy = new_policy(ring_data / "train", token="oracle", token_draw="learned")
    with torch.no_grad():
        policy.model.token_prior.layers[-1].bias += torch.tensor([50.0, 0.0])
    batch = policy_and_batch[1]
    drawn = {
        draw: policy.sample(batch, 40, coupling=SamplingCoupling(token_draw=draw), generator=keyed_generator(1))
        for draw in (None, "learned", "uniform", "marginal")
    }
    assert torch.equal(drawn[None].token, drawn["learned"].token)
    assert not drawn["learned"].token.any()
    for draw in ("uniform", "marginal"):
        assert drawn[draw].token.float().mean() == pytest.approx(0.5, abs=0.1)
    following = SamplingCoupling(token=drawn["uniform"].token)
    assert torch.equal(
        policy.sample(batch, 40, coupling=following, generator=keyed_generator(1)).joint, drawn["uniform"].joint
    )


def test_a_draw_that_a_policy_does_not_have_is_refused(ring_data, policy_and_batch):
    cases = (({"token": "oracle"}, "learned", "has learned no prior"), ({}, "uniform", "has no token to draw"))
    for fields, draw, sentence in cases:
        policy = new_policy(ring_data / "train", **fields)
        with pytest.raises(ValueError, match=sentence):
            policy.sample(policy_and_batch[1], 2, coupling=SamplingCoupling(token_draw=draw))


def test_sampling_many_conditions_together_equals_sampling_each_alone(policy_and_batch):
    """Grouping for speed must not change a sample: the simple loop is the oracle."""
    policy, batch = policy_and_batch
    noise = {"joint": torch.randn(12, 3, 16, 6), "position": torch.randn(12, 3, 16, 2)}
    token = torch.randint(2, (12, 3))
    together = policy.sample(batch, 3, coupling=SamplingCoupling(source_noise=noise, token=token))
    for row in range(12):
        for n in range(3):
            alone = policy.sample(
                {key: batch[key][row : row + 1] for key in policy.observation_keys},
                1,
                coupling=SamplingCoupling(
                    source_noise={h: x[row : row + 1, n : n + 1] for h, x in noise.items()},
                    token=token[row : row + 1, n : n + 1],
                ),
            )
            assert torch.allclose(alone.joint[0, 0], together.joint[row, n], atol=1e-5)
            assert torch.allclose(alone.position[0, 0], together.position[row, n], atol=1e-5)


def test_heads_share_no_velocity_parameters(policy_and_batch):
    policy, _ = policy_and_batch
    fields = policy.model.network.fields
    assert not {id(p) for p in fields["joint"].parameters()} & {id(p) for p in fields["position"].parameters()}


@pytest.mark.parametrize("conditioning", ["film", "concat"])
@pytest.mark.parametrize("preconditioning", ["gaussian", "none"])
def test_the_gradient_of_the_loss_agrees_with_finite_differences(ring_data, conditioning, preconditioning):
    fields = {"conditioning": conditioning, "preconditioning": preconditioning}
    policy = new_policy(ring_data / "train", velocity_width=16, encoder_dim=8, **fields).double()
    frames = read_split(ring_data / "train")
    observation = torch.randn(6, 5, dtype=torch.float64, generator=keyed_generator(0))
    action = torch.from_numpy(frames.action[: 6 * 16].reshape(6, 16, -1)).double()
    policy.compute_loss(observation, action, None)[0].backward()
    step = 1e-5
    for parameter in (
        policy.model.network.encoder.layers[0].weight,
        policy.model.network.fields["joint"].hidden[0].weight,
    ):
        values = []
        for change in (step, -2 * step):
            with torch.no_grad():
                parameter[1, 2] += change
                values.append(policy.compute_loss(observation, action, None)[0].item())
        slope = (values[0] - values[1]) / (2 * step)
        assert slope == pytest.approx(parameter.grad[1, 2].item(), rel=1e-3, abs=1e-7)


def test_the_token_of_an_episode_is_held_until_reset(policy_and_batch):
    policy, batch = policy_and_batch
    row = {key: batch[key][:4] for key in policy.observation_keys}
    policy.reset()
    policy.predict_action_chunk(row)
    held = policy._held.token
    policy.predict_action_chunk(row)
    assert policy._held.token is held
    policy.reset()
    assert policy._held.token is None


def test_a_loaded_policy_equals_the_saved_one(policy_and_batch, tmp_path):
    policy, _ = policy_and_batch
    policy.save_pretrained(tmp_path / "again")
    config = json.loads((tmp_path / "again" / "config.json").read_text())
    assert config["representation"]["kinematic_map"] == "ring/nullspace"
    assert config["n_tokens"] == 2
    saved = load_file(tmp_path / "again" / "model.safetensors")
    assert set(saved) == set(policy.state_dict())
    assert all(torch.equal(saved[key], value) for key, value in policy.state_dict().items())


@pytest.mark.parametrize("damage", ["missing", "unexpected", "misshapen"])
def test_weights_that_do_not_fit_are_refused(copied, damage):
    path = copied / "model.safetensors"
    tensors = load_file(path)
    name = "model.network.fields.joint.output.bias"
    if damage == "missing":
        del tensors[name]
    elif damage == "unexpected":
        tensors["stranger"] = torch.zeros(1)
    else:
        tensors[name] = torch.zeros(3)
    save_file(tensors, path)
    with pytest.raises(ValueError, match="does not belong to this"):
        load_policy(copied)


def test_truncated_weights_are_refused(copied):
    path = copied / "model.safetensors"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(ValueError, match="not a readable safetensors file"):
        load_policy(copied)


def test_missing_weights_and_missing_folders_are_refused(copied, tmp_path):
    (copied / "model.safetensors").unlink()
    with pytest.raises(FileNotFoundError, match=r"model\.safetensors is missing"):
        load_policy(copied)
    with pytest.raises(FileNotFoundError, match="holds no policy"):
        load_policy(tmp_path / "nowhere")


def test_an_unknown_configuration_key_is_refused(copied):
    path = copied / "config.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "colour": "red"}))
    with pytest.raises(ValueError, match="colour"):
        load_policy(copied)


def test_actions_that_are_not_finite_are_refused(ring_data):
    policy = new_policy(ring_data / "train")
    batch = {
        "observation.state": torch.zeros(2, 2),
        "observation.environment_state": torch.zeros(2, 3),
        "action": torch.full((2, 16, 8), float("nan")),
    }
    with pytest.raises(ValueError, match="non-finite action"):
        policy(batch)


def test_a_dataset_of_another_layout_is_refused(trained, tmp_path):
    from lerobot.configs import PreTrainedConfig

    from dualhead_envs.ring.record import record_ring

    other = record_ring(
        "RotatingRing-v2", tmp_path / "polar", episodes=8, conditions=2, env_kwargs={"representation": "polar"}
    )
    config = PreTrainedConfig.from_pretrained(policy_folder(trained))
    config.pretrained_path = policy_folder(trained)
    with pytest.raises(ValueError, match="another action layout than the policy"):
        make_policy(config, ds_meta=LeRobotDatasetMetadata("local/polar", root=other / "train"))


def test_missing_statistics_are_refused(ring_data):
    meta = LeRobotDatasetMetadata("local/ring", root=ring_data / "train")
    del meta.stats["action"]
    with pytest.raises(ValueError, match="statistics lack 'action'"):
        make_policy(DualheadConfig(device="cpu"), ds_meta=meta)


def test_fine_tuning_keeps_or_replaces_the_action_scale(trained, ring_data):
    from lerobot.configs import PreTrainedConfig

    meta = LeRobotDatasetMetadata("local/ring", root=ring_data / "train")
    meta.stats["action"]["std"] = np.asarray(meta.stats["action"]["std"]) * 2
    spreads = {}
    for statistics in ("keep", "replace"):
        config = PreTrainedConfig.from_pretrained(policy_folder(trained), cli_overrides=[f"--statistics={statistics}"])
        config.pretrained_path = policy_folder(trained)
        spreads[statistics] = make_policy(config, ds_meta=meta).model.action_scale.spread
    assert torch.equal(spreads["keep"], load_policy(trained)[0].model.action_scale.spread)
    assert spreads["replace"][0] == pytest.approx(2 * spreads["keep"][0].item(), rel=0.01)
