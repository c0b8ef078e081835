"""The configuration refuses what cannot work, in one sentence."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from lerobot.configs import PreTrainedConfig

from dualhead_policy import DualheadConfig
from dualhead_policy.representation import RepresentationLayout

RING = ["joint.nullspace.0", "joint.nullspace.1", "position.x", "position.y"]


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"source_noise_beta": 1.5}, r"source_noise_beta=1\.5 is outside \[0, 1\]"),
        ({"token": "magic"}, "token='magic' is not one of"),
        ({"token_replacement_prob": 0.1}, "needs a token"),
        ({"n_tokens": 4}, "needs a token"),
        ({"token": "oracle", "token_positions": "displacement"}, "belongs to policy.token='window'"),
        ({"token": "oracle", "n_tokens": 1}, "at least 2"),
        ({"token": "oracle", "token_replacement_prob": 0.6, "token_null_prob": 0.6}, "more than 1"),
        ({"n_action_steps": 17}, "must lie in 1..chunk_size=16"),
        ({"optimizer_lr": 0}, "must be positive"),
        ({"conditioning": "attention"}, "is not one of"),
        ({"latent": "prior", "token": "oracle"}, "two shared variables"),
        ({"latent": "posterior", "latent_dim": 0}, "needs something to infer"),
        ({"latent": "prior", "free_bits": 0.1}, "belongs to policy.latent='posterior'"),
        ({"token_draw": "learned"}, "needs a token"),
        ({"rotation_consistency_weight": 1.0}, "set policy.rotation_head=true"),
        ({"rotation_noise": "private"}, "is that of a rotation head"),
        ({"source_noise_alignment": "kinematic"}, "is about noise that the heads share"),
        ({"source_noise_alignment": "mirror", "source_noise_beta": 0.0}, "is not one of"),
        ({"consistency_weight": -1.0}, "must not be negative"),
        ({"consistency_norm": "inches"}, "is not one of"),
        ({"padded_steps": 16}, "must lie in 0"),
        ({"observation_noise": -0.1}, "must not be negative"),
        ({"embedding_gain": 0.0}, "is outside"),
        ({"embedding_gain": float("nan")}, "is not a finite number"),
        ({"kinematic_map": "file:arm.urdf"}, "not of the form 'file:PATH#LINK'"),
    ],
)
def test_contradictory_fields_are_refused_when_the_configuration_is_built(fields, sentence):
    with pytest.raises(ValueError, match=sentence):
        DualheadConfig(device="cpu", **fields)


def test_a_layout_is_read_from_the_action_names():
    layout = RepresentationLayout.from_names(RING)
    assert layout.kinematic_map == "ring/nullspace"
    assert layout.slices["position"] == slice(2, 4)


@pytest.mark.parametrize(
    "names",
    [None, [], ["x", "y"], ["position.x", "joint.0"], ["joint.0", "joint.1"], ["joint.0", "other", "position.x"]],
)
def test_names_that_are_no_dual_action_vector_are_refused(names):
    with pytest.raises(ValueError, match="dual action vector"):
        RepresentationLayout.from_names(names)


def test_another_layout_is_refused_with_the_first_difference():
    ours = RepresentationLayout.from_names(RING)
    theirs = RepresentationLayout.from_names([name.replace("nullspace", "polar") for name in RING])
    with pytest.raises(ValueError, match=r"'joint.polar.0' instead of 'joint.nullspace.0' at index 0"):
        ours.require_same(theirs, owner="the policy", given="dataset d")


def test_every_field_is_documented():
    text = (Path(__file__).parents[2] / "docs" / "policy.md").read_text()
    inherited = {field.name for field in dataclasses.fields(PreTrainedConfig)}
    own = {field.name for field in dataclasses.fields(DualheadConfig)} - inherited
    assert {name for name in own if f"`{name}`" not in text} == {"normalization_mapping"}
