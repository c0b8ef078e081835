"""What LeRobot's commands may ask of a policy beyond the plain call: done as asked, or refused in a sentence."""

from __future__ import annotations

import pytest
import torch
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy
from torch.testing._internal.distributed.fake_pg import FakeStore

from dualhead_policy import DualheadConfig
from dualhead_policy.flow.draws import draw_step
from dualhead_policy.flow.keyed_random import keyed_generator
from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.trainer import Training


def new_policy(ring_data, **fields):
    meta = LeRobotDatasetMetadata("local/ring", root=ring_data / "train")
    return make_policy(DualheadConfig(device="cpu", velocity_width=16, encoder_dim=8, **fields), ds_meta=meta)


@pytest.fixture(scope="module")
def policy(ring_data):
    return new_policy(ring_data, latent="prior", latent_dim=2)


@pytest.fixture(scope="module")
def batch():
    return {
        "observation.state": torch.zeros(6, 2),
        "observation.environment_state": torch.randn(6, 3, generator=keyed_generator(1)),
        "action": torch.randn(6, 16, 8, generator=keyed_generator(2)),
    }


@pytest.fixture
def rank_one():
    """The second of two processes of a distributed training."""
    torch.distributed.init_process_group("fake", rank=1, world_size=2, store=FakeStore())
    yield
    torch.distributed.destroy_process_group()


def test_every_process_of_a_distributed_training_draws_its_own_noise_and_times(policy, batch, request):
    alone = policy(batch)[0].item()
    assert policy(batch)[0].item() == alone
    request.getfixturevalue("rank_one")
    assert policy(batch)[0].item() != alone


@pytest.mark.parametrize("rank", [0, 1, 7])
def test_the_draws_of_a_rank_are_a_function_of_seed_step_and_rank(policy, batch, rank):
    observation = torch.cat([batch["observation.state"], batch["observation.environment_state"]], dim=-1)

    def draws(rank):
        return draw_step(policy.model, observation, batch["action"], seed=3, step=5, rank=rank, has_tokens=False)

    first, again, other = draws(rank), draws(rank), draws(rank + 1)
    assert torch.equal(first.time, again.time)
    assert torch.equal(first.source["joint"], again.source["joint"])
    for mine, theirs in (
        (first.time, other.time), (first.latent, other.latent), (first.source["position"], other.source["position"])
    ):  # fmt: skip
        assert not torch.isclose(mine, theirs).any()


def test_what_is_measured_beside_the_loss_is_drawn_per_process_too(policy, batch, request):
    observation = torch.cat([batch["observation.state"], batch["observation.environment_state"]], dim=-1)
    alone = policy.measure(observation, batch["action"], None)
    request.getfixturevalue("rank_one")
    assert policy.measure(observation, batch["action"], None)["residual"] != alone["residual"]


def test_a_loss_per_window_is_refused(policy, batch):
    with pytest.raises(ValueError, match=r"reduction='none'.* expected 'mean': train without --sample_weighting"):
        policy.forward(batch, reduction="none")


@pytest.mark.parametrize("method", ["select_action", "predict_action_chunk"])
def test_one_source_noise_for_heads_that_have_one_each_is_refused(policy, batch, method):
    with pytest.raises(ValueError, match=r"got noise=\.\.\., .*SamplingCoupling\(source_noise="):
        getattr(policy, method)(batch, noise=torch.zeros(6, 16, 8))


def test_sample_takes_no_keyword_that_it_would_pass_over(policy, batch):
    with pytest.raises(TypeError, match="noise"):
        policy.sample(batch, 1, noise=torch.zeros(6, 16, 8))


@pytest.mark.parametrize(
    "flag",
    ["--dataset.episodes=[0,1]", "--dataset.eval_split=0.1", "--dataset.streaming=true"],
)
def test_the_fast_trainer_refuses_a_part_of_a_dataset(ring_data, tmp_path, flag):
    """It holds every window of the folder, to which scales and tokens are fitted."""
    cfg = parse_training_config(
        [f"--dataset.root={ring_data / 'train'}", f"--output_dir={tmp_path / 'run'}", flag], None
    )
    with pytest.raises(ValueError, match=f"{flag.split('=')[0]}=.* trains on every window"):
        Training(cfg)


def test_a_lambda_weighs_alike_where_the_flow_loss_is_in_metres(ring_data, batch):
    """Ring actions are not normalised: the consistency loss must not be divided by their variance."""
    policy = new_policy(ring_data, consistency_weight=3.0)
    consistency = {}
    for norm in ("normalized", "meters"):
        policy.config.consistency_norm = norm
        consistency[norm] = policy(batch)[1]["loss_consistency"]
    assert consistency["normalized"] == pytest.approx(consistency["meters"], rel=1e-6)
