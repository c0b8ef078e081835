"""Policies on the robot's layout: every mechanism's gradient, the full dual vector, what is shared and held."""

from __future__ import annotations

import shutil

import gymnasium as gym
import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy
from scipy.spatial.transform import Rotation

from dualhead_envs.bypass.lift_model import lift_mjcf
from dualhead_envs.dataset_frames import read_split
from dualhead_eval.ensembles.scores import vfd_score
from dualhead_policy import DualheadConfig, DualheadPolicy, SamplingCoupling
from dualhead_policy.flow.draws import draw_path_points, draw_step, noisy_chunks
from dualhead_policy.flow.keyed_random import keyed_generator
from dualhead_policy.kinematics.panda import panda_position, panda_rotation
from dualhead_policy.kinematics.rotation6d import columns_from_matrix, matrix_from_columns
from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.trainer import Training

SMALL = {"velocity_width": 16, "encoder_dim": 8, "seed": 0, "device": "cpu"}
MECHANISMS = {
    "independent": {},
    "shared noise": {"source_noise_beta": 0.3},
    "anchor": {"latent": "prior", "latent_dim": 0},
    "prior": {"latent": "prior"},
    "posterior": {"latent": "posterior", "kl_weight": 0.1, "free_bits": 0.01},
    "consistency": {"consistency_weight": 3.0, "source_noise_beta": 0.0},
    "consistency in metres": {"consistency_weight": 300.0, "consistency_norm": "meters"},
    "rotation": {"rotation_head": True, "rotation_consistency_weight": 1.0, "consistency_weight": 1.0},
    "learned prior": {"token": "episode", "token_draw": "learned", "token_replacement_prob": 0.1},
    "window": {"token": "window", "n_tokens": 3, "token_null_prob": 0.1},
    "oracle": {"token": "oracle", "consistency_weight": 0.1, "source_noise_beta": 0.9},
    "bare network": {"preconditioning": "none", "conditioning": "concat", "consistency_weight": 1.0},
}


@pytest.fixture(scope="module")
def build(panda_data):
    meta = LeRobotDatasetMetadata("local/panda", root=panda_data / "train")

    def build(**fields):
        return make_policy(DualheadConfig(**{**SMALL, **fields}), ds_meta=meta)

    return build


@pytest.fixture(scope="module")
def windows(panda_data):
    """Preprocessed-like observations (B, C), action windows (B, H, D) and tokens around the branches."""
    frames = read_split(panda_data / "train")
    starts = np.flatnonzero(frames.frame_index == frames.labels["branch_step"])
    action = torch.from_numpy(frames.action[starts[:, None] + np.arange(16)]).double()
    observation = torch.randn(len(starts), 42, dtype=torch.float64, generator=keyed_generator(0))
    return observation, action, torch.from_numpy(frames.labels["mode"][starts])


@pytest.fixture(scope="module")
def batch(windows):
    observation = windows[0].float()
    return {"observation.state": observation[:, :24], "observation.environment_state": observation[:, 24:]}


@pytest.mark.parametrize("name", MECHANISMS)
def test_the_gradient_of_every_mechanism_agrees_with_finite_differences(build, windows, name):
    policy = build(**MECHANISMS[name]).double()
    observation, action, token = windows
    token = token if policy.model.tokens is not None else None
    loss, parts = policy.compute_loss(observation, action, token)
    loss.backward()
    assert loss.item() == pytest.approx(sum(part.item() for part in parts.values()))
    step = 1e-6
    matrices = [(n, p) for n, p in policy.named_parameters() if p.ndim == 2 and p.grad is not None]
    # The prior reads the encoder without moving it: there the slope is not the gradient.
    matrices = [
        (n, p) for n, p in matrices if policy.model.token_prior is None or not n.startswith("model.network.encoder")
    ]
    modules = {name.rsplit(".", 2)[0]: parameter for name, parameter in matrices}
    assert len(modules) >= 6
    for parameter in modules.values():
        where = divmod(int(parameter.grad.abs().argmax()), parameter.shape[1])
        values = []
        for change in (step, -2 * step):
            with torch.no_grad():
                parameter[where] += change
                values.append(policy.compute_loss(observation, action, token)[0].item())
        with torch.no_grad():
            parameter[where] += step
        assert (values[0] - values[1]) / (2 * step) == pytest.approx(parameter.grad[where].item(), rel=1e-3, abs=1e-7)


def plain_endpoints(policy, observation, action, purpose):
    """Clean endpoints outside the frames, in the plain coordinates of the paper: a = x_t + (1 - t) v."""
    generator = keyed_generator(policy.config.seed, 0, purpose)
    chunks = noisy_chunks(policy.model, observation, action, *draw_path_points(policy.model, action, generator))
    context = policy.model.network.encoder(observation)
    endpoint = {}
    for head, part in policy.model.head_slices.items():
        frame, time = policy.model.frame(head), chunks.time[:, None]
        inside = policy.model.velocity(head, chunks.at_time(head), chunks.time, context)
        velocity = inside @ frame.basis.T + frame.mean(observation)
        noise = chunks.source[head] @ frame.basis.T
        x = (1 - time) * noise + time * policy.model.action_scale.normalize(action)[..., part].flatten(1)
        clean = (x + (1 - time) * velocity).unflatten(1, (16, -1))
        endpoint[head] = policy.model.action_scale.unnormalize(clean, part)
    return endpoint


def test_the_consistency_loss_is_that_of_the_clean_endpoints(build, windows):
    policy = build(consistency_weight=2.0, source_noise_beta=0.0, observation_noise=0.0).double()
    observation, action, _ = windows
    _, parts = policy.compute_loss(observation, action, None)
    endpoint = plain_endpoints(policy, observation, action, "train")
    difference = (panda_position(endpoint["joint"]) - endpoint["position"]) / policy.model.action_scale.scale[7:10]
    assert parts["consistency"].item() == pytest.approx(2 * difference.square().mean().item())


def test_teacher_forced_residuals_are_those_of_the_clean_endpoints(build, windows):
    policy = build(rotation_head=True, observation_noise=0.0).double()
    observation, action, _ = windows
    residual = policy.measure(observation, action, None)["residual"]
    endpoint = plain_endpoints(policy, observation, action, "residual")
    apart = (panda_position(endpoint["joint"]) - endpoint["position"]).detach().numpy()
    assert residual["position_mm"] == pytest.approx(1000 * np.linalg.norm(apart, axis=-1).mean())
    ours = panda_rotation(endpoint["joint"]).detach().numpy().reshape(-1, 3, 3)
    theirs = matrix_from_columns(endpoint["rotation"]).detach().numpy().reshape(-1, 3, 3)
    angle = (Rotation.from_matrix(ours).inv() * Rotation.from_matrix(theirs)).magnitude()
    assert residual["rotation_deg"] == pytest.approx(np.degrees(angle).mean(), rel=1e-4)


def test_a_mechanism_leaves_the_noise_and_times_of_the_others_as_they_are(build, windows):
    observation, action, _ = windows
    draws = []
    for fields in ({}, {"latent": "prior"}, {"rotation_head": True}):
        policy = build(**fields, observation_noise=0.0).double()
        draws.append(draw_step(policy.model, observation, action, seed=0, step=0, has_tokens=False))
    for other in draws[1:]:
        assert torch.equal(draws[0].time, other.time)
        assert torch.equal(draws[0].source["joint"], other.source["joint"])
        assert torch.equal(draws[0].source["position"], other.source["position"])


def test_the_gripper_moves_neither_the_encoder_nor_a_head(build, windows):
    policy = build().double()
    observation, action, _ = windows
    policy.compute_loss(observation, action, None)[1]["gripper"].backward()
    touched = {name for name, parameter in policy.named_parameters() if parameter.grad is not None}
    assert touched == {name for name, _ in policy.model.gripper.named_parameters(prefix="model.gripper")}


@pytest.mark.parametrize("name", ["independent", "prior", "rotation", "learned prior", "bare network"])
def test_a_chunk_is_the_whole_dual_vector(build, batch, name):
    policy = build(**MECHANISMS[name]).eval()
    samples = policy.sample(batch, 3, generator=keyed_generator(1))
    n = len(batch["observation.state"])
    assert samples.joint.shape == (n, 3, 16, 7)
    assert samples.position.shape == (n, 3, 16, 3)
    chunk = policy.dual_chunk(samples)
    assert chunk.shape == (n, 16, 17)
    assert torch.equal(chunk[..., :7], samples.joint[:, 0])
    assert torch.equal(chunk[..., 7:10], samples.position[:, 0])
    assert set(chunk[..., 16].unique().tolist()) <= {-1.0, 1.0}
    if name == "rotation":
        assert torch.equal(chunk[..., 10:16], samples.rotation[:, 0])
        matrices = matrix_from_columns(samples.rotation)
        assert torch.allclose(columns_from_matrix(matrices), samples.rotation, atol=1e-5)
    else:
        start = columns_from_matrix(panda_rotation(samples.joint[:, 0, 0]))
        assert torch.equal(chunk[:, 5, 10:16], start)


def test_a_policy_does_not_extrapolate_beyond_the_observations_it_has_seen(build, batch):
    policy = build().eval()
    wild = {key: 1e6 * value for key, value in batch.items()}
    wilder = {key: 1e9 * value for key, value in batch.items()}
    one, other = (policy.sample(b, 1, generator=keyed_generator(0)) for b in (wild, wilder))
    assert torch.equal(one.position, other.position)
    assert one.position.abs().max() < 10


def test_without_a_rotation_head_the_start_orientation_is_held_until_reset(build, batch):
    policy = build().eval()
    first = policy.predict_action_chunk(batch)
    second = policy.predict_action_chunk(batch)
    assert torch.equal(first[:, 0, 10:16], second[:, 7, 10:16])
    policy.reset()
    assert not torch.equal(policy.predict_action_chunk(batch)[:, 0, 10:16], first[:, 0, 10:16])


def test_a_latent_is_drawn_once_an_episode_and_shared_by_the_heads(build, batch):
    policy = build(latent="prior").eval()
    policy.predict_action_chunk(batch)
    held = policy._held.latent
    policy.predict_action_chunk(batch)
    assert policy._held.latent is held
    policy.reset()
    assert policy._held.latent is None
    one = policy.sample(batch, 2, generator=keyed_generator(3))
    noise = {"joint": torch.randn(8, 2, 16, 7), "position": torch.randn(8, 2, 16, 3)}
    given = [
        policy.sample(
            batch, 2, coupling=SamplingCoupling(source_noise=noise, latent=one.latent, share_latent=share),
            generator=keyed_generator(4),
        )
        for share in (True, False)
    ]  # fmt: skip
    assert torch.equal(given[0].joint, given[1].joint)
    assert not torch.equal(given[0].position, given[1].position)
    assert torch.equal(given[0].latent, one.latent)


def test_sampling_with_latents_one_by_one_equals_sampling_together(build, batch):
    policy = build(latent="posterior").eval()
    noise = {"joint": torch.randn(8, 2, 16, 7), "position": torch.randn(8, 2, 16, 3)}
    latent = torch.randn(8, 2, 16)
    together = policy.sample(batch, 2, coupling=SamplingCoupling(source_noise=noise, latent=latent))
    row = {key: value[5:6] for key, value in batch.items()}
    coupling = SamplingCoupling(
        source_noise={head: value[5:6, 1:] for head, value in noise.items()}, latent=latent[5:6, 1:]
    )
    alone = policy.sample(row, 1, coupling=coupling)
    assert torch.allclose(alone.position[0, 0], together.position[5, 1], atol=1e-5)
    assert torch.allclose(alone.joint[0, 0], together.joint[5, 1], atol=1e-5)


def test_window_tokens_are_drawn_at_every_decision_and_episode_tokens_once(build, batch):
    for fields, held in (({"token": "episode", "token_draw": "learned"}, True), ({"token": "window"}, False)):
        policy = build(**fields).eval()
        policy.predict_action_chunk(batch)
        first = policy._held.token
        policy.predict_action_chunk(batch)
        assert (policy._held.token is first) == held


def test_episode_tokens_are_the_modes_and_the_nmi_is_in_the_configuration(build, panda_data):
    policy = build(token="episode")
    frames = read_split(panda_data / "train")
    modes = torch.from_numpy(frames.labels["mode"][frames.frame_index == 0])
    assert torch.equal(policy.episode_token, modes) or torch.equal(policy.episode_token, 1 - modes)
    assert policy.config.token_nmi == pytest.approx(1)
    assert policy.model.tokens.marginal.tolist() == [0.5, 0.5]
    window = build(token="window")
    assert 0 <= window.config.token_nmi < 1


def test_fine_tuning_reads_new_episodes_with_the_checkpoints_centroids(build, tmp_path):
    """A second clustering may number its clusters differently; the heads know the first numbering."""
    policy = build(token="episode")
    expected = policy.episode_token.clone()
    policy.model.tokens.centroids.copy_(policy.model.tokens.centroids.flip(0))
    policy.save_pretrained(tmp_path)
    again = build(token="episode", n_tokens=2, pretrained_path=tmp_path)
    assert torch.equal(again.episode_token, 1 - expected)


def test_the_latents_influence_is_measured(build, windows):
    observation, action, _ = windows

    def influence(**fields):
        return build(**fields).double().measure(observation, action, None).get("latent_sensitivity")

    assert influence(latent="prior", latent_dim=0) == {"joint": 0, "position": 0}
    assert all(0 < change < 2 for change in influence(latent="prior").values())
    assert influence() is None


def test_a_robots_file_gives_the_consistency_loss_of_the_built_in_arm(build, windows, tmp_path):
    """The way to bring another robot, on the one robot whose answer is known."""
    path = tmp_path / "lift.xml"
    path.write_text(lift_mjcf())
    losses = {}
    for kinematics in (None, f"file:{path}#gripper0_grip_site"):
        torch.manual_seed(0)
        policy = build(kinematic_map=kinematics, consistency_weight=1.0).double()
        losses[kinematics] = policy.compute_loss(*windows[:2], None)[1]["consistency"].item()
    built_in, from_file = losses.values()
    assert from_file == pytest.approx(built_in, rel=1e-4)


def test_a_folder_brings_the_robots_file_along(build, batch, tmp_path):
    """Without a rotation head, a deployed policy needs the kinematics to hold the start orientation."""
    path = tmp_path / "elsewhere" / "lift.xml"
    path.parent.mkdir()
    path.write_text(lift_mjcf())
    policy = build(kinematic_map=f"file:{path}#gripper0_grip_site")
    policy.save_pretrained(tmp_path / "hub")
    shutil.rmtree(path.parent)
    deployed = DualheadPolicy.from_pretrained(tmp_path / "hub")
    assert deployed.predict_action_chunk(batch).isfinite().all()
    deployed.save_pretrained(tmp_path / "again")
    assert {file.suffix for file in (tmp_path / "again").iterdir()} == {".safetensors", ".json", ".md"}
    assert (tmp_path / "again" / "robot.json").read_text() == (tmp_path / "hub" / "robot.json").read_text()


def test_a_new_policy_without_its_robots_file_is_refused(build, tmp_path):
    with pytest.raises(FileNotFoundError, match="does not exist"):
        build(kinematic_map=f"file:{tmp_path / 'arm.urdf'}#tool0")


def test_policies_that_call_their_robots_alike_keep_their_own(build, tmp_path):
    """A folder's own copy decides, whatever another policy carries and whatever the path holds by now."""
    path, kinematics = tmp_path / "arm.xml", f"file:{tmp_path / 'arm.xml'}#gripper0_grip_site"
    joints = torch.zeros(1, 7, dtype=torch.float64)
    for height in (0.0, 1.0):
        base = 'name="robot0_base" pos="-0.56 0.0 {}"'
        path.write_text(lift_mjcf().replace(base.format(0.912), base.format(0.912 + height)))
        build(kinematic_map=kinematics).save_pretrained(tmp_path / f"{height}")
    path.unlink()
    low, high = (DualheadPolicy.from_pretrained(tmp_path / f"{height}").model.kinematics for height in (0.0, 1.0))
    assert (high.position(joints) - low.position(joints))[0].tolist() == pytest.approx([0, 0, 1], abs=1e-6)


@pytest.mark.parametrize("name", ["independent", "prior", "oracle", "bare network"])
@pytest.mark.parametrize("head", ["joint", "position"])
def test_a_walk_along_the_velocity_field_ends_where_sampling_does(build, batch, name, head):
    policy = build(**MECHANISMS[name]).eval()
    for parameter in policy.model.network.parameters():
        torch.nn.init.normal_(parameter, std=0.1)
    n = len(batch["observation.state"])
    noise = {h: torch.randn(n, 1, 16, d, generator=keyed_generator(3)) for h, d in policy.model.head_dims.items()}
    drawn = policy.sample(batch, 1, num_steps=5, coupling=SamplingCoupling(source_noise=noise))
    shared = {"token": drawn.token, "latent": drawn.latent}
    field = policy.velocity_field(batch, head, **{k: v[:, 0] for k, v in shared.items() if v is not None})
    x = noise[head][:, 0].numpy()
    for step in range(5):
        x = x + field(x, step / 5) / 5
    frame = policy.model.frames[head] if policy.model.frames else None
    clean = torch.from_numpy(x).flatten(1)
    clean = clean if frame is None else frame.rotate(clean)
    expected = policy.model.physical_chunk(head, clean, policy._observation(batch))
    # Samples whose flow was held to the training range leave the bare field behind.
    free = ~drawn.diverged[:, 0]
    assert free.any()
    assert torch.allclose(getattr(drawn, head)[free, 0], expected[free], atol=1e-4)
    # The same member twice does not disagree with itself.
    assert vfd_score([field, field], noise[head][:, 0].numpy(), num_steps=3).max() == 0


def test_a_velocity_field_without_its_token_is_refused(build, batch):
    with pytest.raises(ValueError, match="needs a token for every row"):
        build(token="oracle").velocity_field(batch)
    with pytest.raises(ValueError, match="has no latent"):
        build().velocity_field(batch, latent=torch.zeros(4, 16))
    with pytest.raises(ValueError, match="has no head 'rotation'"):
        build().velocity_field(batch, "rotation")


def test_rotations_are_the_environments(panda_data):
    """Frames: the 6-D rotation in data and observations is that of the kinematics, not the hand body's."""
    frames = read_split(panda_data / "test")
    ours = columns_from_matrix(panda_rotation(torch.from_numpy(frames.action[:, :7]).double()))
    assert np.abs(ours.numpy() - frames.action[:, 10:16]).max() < 1e-5
    env = gym.make("dualhead_envs:RotatingBypass-v3")
    observed = env.reset(seed=0)[0]["agent_pos"]
    env.close()
    start = columns_from_matrix(panda_rotation(torch.from_numpy(observed[:7]).double()))
    assert start.numpy() == pytest.approx(observed[17:23], abs=1e-5)


def test_windows_at_an_episodes_end_repeat_its_last_action(panda_data, tmp_path):
    flags = [f"--dataset.root={panda_data / 'train'}", f"--output_dir={tmp_path / 'run'}", "--batch_size=100000"]
    training = Training(parse_training_config([*flags, "--policy.device=cpu"], None))
    frames = read_split(panda_data / "train")
    assert len(training.source) == len(frames.action)
    action = training.source.batch(0).action
    last = torch.from_numpy(frames.action[np.flatnonzero(np.diff(frames.episode_index, append=-1))])
    held = action[(action == action[:, :1]).all(dim=(1, 2))]
    assert all((held[:, 0] == row).all(dim=1).any() for row in last)
