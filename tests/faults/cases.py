"""One command with bad input, and how to make it from a whole product and a damage of one of its files."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from damage import Damage


@dataclass(frozen=True)
class Case:
    """One command with bad input.

    Attributes:
        name: Format and damage.
        prepare: Makes the input in an empty folder and returns the command's arguments.
        mentions: Words of which the refusal must hold one: the file's or the option's name.
    """

    name: str
    prepare: Callable[[Path], list[str]] = field(repr=False)
    mentions: tuple[str, ...]


@dataclass(frozen=True)
class Products:
    """Whole products to damage.

    Attributes:
        data: A recorded ring.
        run: Output folder of a training run on it.
        gate: A gate file.
        rollouts: A rollouts file.
        act: Output folder of `lerobot-train` with an ACT policy on it.
    """

    data: Path
    run: Path
    gate: Path
    rollouts: Path
    act: Path


def file_case(name: str, whole: Path, damage: Damage, command: Callable[[Path], list[str]]) -> Case:
    def prepare(folder: Path) -> list[str]:
        target = folder / whole.name
        shutil.copy(whole, target)
        damage(target)
        return command(target)

    return Case(name, prepare, (whole.name,))


def tree_case(
    name: str, whole: Path, file: str, damage: Damage, command: Callable[[Path], list[str]], *more: str
) -> Case:
    """A damage of one file of a folder."""

    def prepare(folder: Path) -> list[str]:
        target = shutil.copytree(whole, folder / "input", symlinks=True)
        damage(target / file)
        return command(target)

    return Case(name, prepare, (Path(file).name, *more))


def report(path: Path) -> list[str]:
    return ["report", str(path)]
