"""The solver's folded fields give what walking along the model's own velocity gives, however rows are grouped."""

from __future__ import annotations

import pytest
import torch
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy

from dualhead_policy import DualheadConfig, SamplingCoupling
from dualhead_policy.flow import solver
from dualhead_policy.flow.flow_matching import integrate_within
from dualhead_policy.flow.keyed_random import keyed_generator

MECHANISMS = {
    "independent": {},
    "oracle token": {"token": "oracle"},
    "latent": {"latent": "prior"},
    "paper's network": {"preconditioning": "none", "conditioning": "concat"},
    "paper's network, window token": {
        "preconditioning": "none",
        "conditioning": "concat",
        "token": "window",
        "n_tokens": 3,
    },
}
N_CONDITIONS, N_SAMPLES, N_STEPS = 3, 11, 6


@pytest.fixture(scope="module", params=MECHANISMS)
def policy(panda_data, request):
    meta = LeRobotDatasetMetadata("local/panda", root=panda_data / "train")
    config = DualheadConfig(velocity_width=16, encoder_dim=8, seed=0, device="cpu", **MECHANISMS[request.param])
    policy = make_policy(config, ds_meta=meta).eval().double()
    generator = keyed_generator(0)
    for parameter in policy.model.network.parameters():
        torch.nn.init.normal_(parameter, std=0.15, generator=generator)
    return policy


def walk(model, head, noise, observation, drawn):
    """Clean chunks by the plain loop: one row after the other, no context shared."""
    rows = observation.repeat_interleave(N_SAMPLES, dim=0)
    token = None if drawn.token is None else drawn.token.flatten()
    latent = None if drawn.latent is None else drawn.latent.flatten(0, 1)
    context = model.context(model.embed(rows), token, latent)
    source = noise.flatten(2).flatten(0, 1)
    source = model.frame(head).rotate(source) if model.frames else source

    def velocity(x, time):
        return model.velocity(head, x, torch.full((len(x),), time, dtype=x.dtype), context)

    clean, _ = integrate_within(velocity, source, N_STEPS, *model.endpoint_range(head).bounds())
    return model.physical_chunk(head, clean, rows)


@pytest.mark.parametrize(
    "grouping",
    [{}, {"SAMPLING_ROWS": 4}, {"ROWS_OF_ONE_CONTEXT": 1}, {"FOLDED_CONTEXTS": 5, "SAMPLING_ROWS": 7}],
    ids=["together", "small pieces", "one context at a time", "few steps at a time"],
)
@torch.no_grad()
def test_samples_are_the_ends_of_plain_walks(policy, monkeypatch, grouping):
    for name, value in grouping.items():
        monkeypatch.setattr(solver, name, value)
    model, generator = policy.model, keyed_generator(1)
    dims = {key: policy.config.input_features[key].shape[0] for key in policy.observation_keys}
    batch = {key: torch.randn(N_CONDITIONS, dim, generator=generator).double() for key, dim in dims.items()}
    noise = {
        head: torch.randn(N_CONDITIONS, N_SAMPLES, 16, dim, generator=generator).double()
        for head, dim in model.head_dims.items()
    }
    coupling = SamplingCoupling(source_noise=noise)
    drawn = policy.sample(batch, N_SAMPLES, num_steps=N_STEPS, coupling=coupling, generator=generator)
    observation = policy._observation(batch)
    for head in model.head_dims:
        expected = walk(model, head, noise[head], observation, drawn).unflatten(0, (N_CONDITIONS, N_SAMPLES))
        assert torch.allclose(getattr(drawn, head), expected, rtol=1e-9, atol=1e-9), head
