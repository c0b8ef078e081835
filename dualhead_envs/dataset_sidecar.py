"""The schema of ``meta/dualhead.json``: what a recorded dataset says of its environment, beside LeRobot's own files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, TypeAdapter, model_validator

from dualhead_envs.validated_json import Label, Schema, printable, read_json, shown, validated

#: Where the description lies in a dataset's folder.
SIDECAR = Path("meta", "dualhead.json")
REMEDY = "record the dataset again"
#: What a rollout dataset's description is, and what to do about a file that is none.
ROLLOUTS_KIND = "a description of recorded rollouts"
ROLLOUTS_REMEDY = "not a dataset of recorded rollouts, record one with `dualhead evaluate --policy ... --record DIR`"


def _environment(name: str) -> str:
    if not re.fullmatch(r"(RotatingRing|BimodalBypass|RotatingBypass)-v[0-9]{1,3}", name):
        raise ValueError("names no environment of dualhead_envs")
    return name


#: Id of one of our environments: what is named here is imported and made.
EnvironmentId = Annotated[Label, AfterValidator(_environment)]
Count = Annotated[int, Field(ge=0, le=2**53)]
Positive = Annotated[int, Field(ge=1, le=2**31)]


class PartitionDescription(Schema):
    """A mode partition, as ``mode_partition.to_dict()`` gives it."""

    name: Label
    n_modes: Annotated[int, Field(ge=2, le=1000)]
    tau: Annotated[float, Field(ge=0)]
    parameters: dict[Label, Any]


class DatasetSidecar(Schema):
    """``meta/dualhead.json`` of recorded demonstrations."""

    format: Literal["dualhead-dataset/1"]
    layout: Label
    env_id: EnvironmentId
    env_kwargs: dict[Label, Any] = Field(default_factory=dict)
    split: Label | None = None
    seed: Count | None = None
    conditions_seed: Count | None = None
    rejections: Count | None = None
    horizon: Annotated[int, Field(ge=1, le=10_000)] = 16
    mode_probabilities: list[Annotated[float, Field(ge=0, le=1)]] | None = None
    partition: PartitionDescription

    @model_validator(mode="after")
    def _probabilities_are_of_the_modes(self) -> DatasetSidecar:
        given = self.mode_probabilities
        if given is not None and (len(given) != self.partition.n_modes or abs(sum(given) - 1) > 1e-6):
            raise ValueError(
                f"holds mode_probabilities {shown(given)}, expected {self.partition.n_modes} that sum to 1"
            )
        return self


class Outcome(Schema):
    """What became of one episode."""

    seed: Count
    success: bool
    collision: bool
    mode: Annotated[int, Field(ge=-1, le=1000)]
    #: Frames in the dataset; with none the episode is not in it. None in recordings that did not count them.
    frames: Count | None = None
    #: Why a decision was refused, which ended the episode; None if it ran to its end.
    refused: Annotated[str, Field(min_length=1, max_length=2000), AfterValidator(printable)] | None = None
    #: How an episode of a robot environment failed, and the step at which its perturbation began (-1: none).
    failure: Label | None = None
    onset: Annotated[int, Field(ge=-1, le=2**31)] | None = None

    @model_validator(mode="after")
    def _ended_in_one_way(self) -> Outcome:
        if self.success and self.collision:
            raise ValueError("has both success and collision, expected at most one")
        return self


class RolloutSidecar(Schema):
    """``meta/dualhead.json`` of recorded rollouts."""

    format: Literal["dualhead-rollouts/1"]
    layout: Label
    env_id: EnvironmentId
    env_kwargs: dict[Label, Any]
    horizon: Annotated[int, Field(ge=1, le=10_000)]
    samples: Positive
    #: Pairs of a decision that follow the token or latent of the episode; None in recordings that did not say so.
    held_pairs: Count | None = None
    num_inference_steps: Positive
    seed: Count
    partition: PartitionDescription
    outcomes: Annotated[list[Outcome], Field(min_length=1)]
    policy: dict[str, Any] = Field(default_factory=dict)


def read_sidecar(root: Path) -> dict[str, Any]:
    """The checked content of a demonstration dataset's ``meta/dualhead.json``; empty if it has none.

    Raises:
        ValueError: If the file is damaged or of another kind.
    """
    if not (root / SIDECAR).is_file():
        return {}
    document = read_json(root / SIDECAR, kind="a description of recorded demonstrations", remedy=REMEDY)
    return _content(document, DatasetSidecar, root / SIDECAR, REMEDY)


def read_rollout_sidecar(path: Path) -> dict[str, Any]:
    """The checked content of a rollout dataset's ``meta/dualhead.json``, or of a copy of it.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is damaged or of another kind.
    """
    return checked_rollouts(read_json(path, kind=ROLLOUTS_KIND, remedy=ROLLOUTS_REMEDY), path)


def checked_rollouts(document: Any, source: Path) -> dict[str, Any]:
    """A JSON document as the description of recorded rollouts.

    Args:
        document: What was read.
        source: Its file, for errors.

    Raises:
        ValueError: If it is none.
    """
    content = _content(document, RolloutSidecar, source, ROLLOUTS_REMEDY)
    seeds = [outcome["seed"] for outcome in content["outcomes"]]
    if len(set(seeds)) < len(seeds):
        raise ValueError(
            f"{source} holds an episode's seed twice, expected each episode once: record the rollouts again"
        )
    if content["env_kwargs"].get("control") not in ("joint", "position", "pose"):
        raise ValueError(
            f"{source} has no env_kwargs.control of 'joint', 'position' or 'pose', expected the head that drove: "
            "record the rollouts again"
        )
    return content


def _content[T: Schema](document: Any, schema: type[T], source: Path, remedy: str) -> dict[str, Any]:
    checked = validated(document, schema, source=str(source), remedy=remedy)
    return TypeAdapter(schema).dump_python(checked, exclude_unset=True)
