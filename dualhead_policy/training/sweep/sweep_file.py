"""``SWEEP.yaml``: what a sweep trains, as its file says it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from dualhead_envs.validated_json import Schema
from dualhead_envs.validated_yaml import read_validated_yaml

#: Value of a flag in a YAML file.
FlagValue = str | bool | int | float


def _folder_name(name: str) -> str:
    if not name or name.startswith(".") or not all(char.isalnum() or char in "._-+=" for char in name):
        raise ValueError("names a folder: use letters, digits and . _ - + =, not beginning with a dot")
    return name


Name = Annotated[str, AfterValidator(_folder_name)]


class NamedConfiguration(Schema):
    """A configuration with flags of its own: a row of a ladder."""

    name: Name
    config: str | None = None
    flags: dict[str, FlagValue] = Field(default_factory=dict)


class SweepFile(Schema):
    """The content of a sweep file.

    Attributes:
        output: Folder of the sweep: runs lie in ``OUTPUT/DATASET/CONFIGURATION/seed-S``.
        datasets: Training splits by name, for example ``{v2: data/v2/train}``.
        configurations: Configuration files of ``dualhead train``, or named ones with flags.
        seeds: Seeds; every configuration is trained with each on every dataset.
        preset: Training budget that flags override; None: the configuration files' own, or smoke.
        flags: Flags of ``dualhead train`` for every run, without dashes: ``{steps: 20000, policy.device: cpu}``.
        fresh_paths: Ring only: new paths at every step.
    """

    output: str
    datasets: dict[Name, str] = Field(min_length=1)
    configurations: list[str | NamedConfiguration] = Field(min_length=1)
    seeds: list[Annotated[int, Field(ge=0)]] = Field(min_length=1)
    preset: Literal["smoke", "full", "paper"] | None = None
    flags: dict[str, FlagValue] = Field(default_factory=dict)
    fresh_paths: bool = False


@dataclass(frozen=True)
class SweepRun:
    """One run of a sweep.

    Attributes:
        name: ``DATASET/CONFIGURATION/seed-S``; also its folder under the sweep's.
        dataset: Folder of the training split.
        seed: Its seed.
        arguments: Flags of ``dualhead train`` but for the output folder.
        preset, fresh_paths: As in the sweep file.
        save_at: Steps at which it saves a checkpoint besides those of ``save_freq``.
    """

    name: str
    dataset: str
    seed: int
    arguments: tuple[str, ...]
    preset: str | None = None
    fresh_paths: bool = False
    save_at: tuple[int, ...] = ()


def read_sweep(path: Path) -> SweepFile:
    """Read a sweep file.

    Raises:
        FileNotFoundError: If there is none.
        ValueError: If it is not YAML, or does not fit :class:`SweepFile`.
    """
    return read_validated_yaml(
        path, SweepFile, what="a sweep", remedy="see docs/sweeps.md for the fields of a sweep file"
    )


def expand(sweep: SweepFile) -> list[SweepRun]:
    """Every run of a sweep, in the file's order.

    Raises:
        FileNotFoundError: If a configuration file or dataset is missing.
        ValueError: If two runs have one name.
    """
    configurations = [named(configuration) for configuration in sweep.configurations]
    for configuration in configurations:
        if configuration.config is not None and not Path(configuration.config).is_file():
            raise FileNotFoundError(
                f"configuration {configuration.config} of the sweep does not exist: paths are relative to the folder "
                "in which you give the command"
            )
    for name, root in sweep.datasets.items():
        if not (Path(root) / "meta" / "info.json").is_file():
            raise FileNotFoundError(
                f"dataset {name} of the sweep, {root}, is not a LeRobotDataset (no meta/info.json): give the folder of "
                "a training split, for example data/ring/train"
            )
    runs = [
        SweepRun(
            f"{name}/{configuration.name}/seed-{seed}",
            root,
            seed,
            (
                *([f"--config_path={Path(configuration.config).resolve()}"] if configuration.config else []),
                f"--dataset.root={Path(root).resolve()}",
                f"--seed={seed}",
                *command_flags(sweep.flags | configuration.flags),
            ),
            sweep.preset,
            sweep.fresh_paths,
        )
        for (name, root), configuration, seed in itertools.product(sweep.datasets.items(), configurations, sweep.seeds)
    ]
    seen: set[str] = set()
    for run in runs:
        if run.name in seen:
            raise ValueError(f"the sweep has the run {run.name} twice: give each configuration a name and seed once")
        seen.add(run.name)
    return runs


def named(configuration: str | NamedConfiguration) -> NamedConfiguration:
    """A configuration with its name: a file's is the file's."""
    if isinstance(configuration, NamedConfiguration):
        return configuration
    return NamedConfiguration(name=Path(configuration).stem, config=configuration)


def command_flags(flags: Mapping[str, FlagValue]) -> list[str]:
    """Flags of a file as ``dualhead train`` takes them.

    >>> command_flags({"steps": 600, "policy.rotation_head": True})
    ['--steps=600', '--policy.rotation_head=true']

    Raises:
        ValueError: If they hold one that each run has of its own.
    """
    for name in flags:
        if name in ("seed", "output_dir", "dataset.root", "resume", "config_path"):
            raise ValueError(f"the sweep's flags hold {name!r}, which the sweep sets itself: leave it out")
    return [f"--{name}={str(value).lower() if isinstance(value, bool) else value}" for name, value in flags.items()]
