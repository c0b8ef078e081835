"""The checkpoint's folder explains itself: mechanism, data, tokens, numbers, how to use it."""

from __future__ import annotations

import pytest
import yaml

from dualhead_policy import DualheadConfig
from dualhead_policy.model_card import mechanism_lines, model_card
from dualhead_policy.pretrained import load_policy, policy_folder


def test_a_trained_policys_card_says_what_it_is_and_how_to_run_it(trained):
    text = (policy_folder(trained) / "README.md").read_text()
    metadata = yaml.safe_load(text.split("---")[1])
    assert metadata["library_name"] == "lerobot"
    assert "# Dual-head policy for RotatingRing-v2" in text
    assert "one of 2 tokens, the demonstration's mode (family K)" in text
    assert "Usage in training: 0.5" in text
    assert "- Steps: 30" in text
    assert "--env.type=rotating_ring --env.n_modes=2 --env.representation=nullspace" in text


def test_the_folder_holds_safetensors_json_and_the_card_alone(trained):
    suffixes = {path.suffix for path in policy_folder(trained).iterdir()}
    assert suffixes == {".safetensors", ".json", ".md"}


def test_the_card_pushed_to_a_hub_is_the_folders_own(trained):
    policy, _ = load_policy(trained)
    assert policy.generate_model_card("local/ring", "dualhead", None, None).content == (
        (policy_folder(trained) / "README.md").read_text()
    )


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({}, "share nothing but the condition encoder (family A)"),
        ({"source_noise_beta": 0.0}, "source noise is fully shared"),
        ({"latent": "prior", "latent_dim": 0}, "family C"),
        ({"latent": "posterior"}, "amortised posterior (family E)"),
        ({"consistency_weight": 3.0}, "lambda = 3, normalized norm"),
        ({"rotation_head": True, "rotation_consistency_weight": 1.0}, "squared geodesic angle"),
        ({"token": "window", "n_tokens": 4, "token_draw": "learned"}, "4 tokens, k-means on the training windows'"),
    ],
)
def test_every_mechanism_is_named(fields, words):
    assert words in " ".join(mechanism_lines(DualheadConfig(device="cpu", **fields)))


def test_protocol_numbers_and_mutual_information_appear_when_they_are_known():
    config = DualheadConfig(device="cpu", token="window", n_tokens=2, token_nmi=0.1717, dataset_name="someone/bypass")
    text = model_card(config, step=5, token_usage=[0.674, 0.326], results={"rho": 1.0, "valid-pair rate": 0.9871})
    assert "0.674 / 0.326" in text
    assert "0.1717" in text
    assert "| valid-pair rate | 0.9871 |" in text
    assert yaml.safe_load(text.split("---")[1])["datasets"] == ["someone/bypass"]
    assert "Protocol numbers" not in model_card(config, step=5, token_usage=None)
