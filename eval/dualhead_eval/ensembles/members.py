"""The members of an ensemble, opened by path."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dualhead_eval.evaluation.many_policies import run_name
from dualhead_eval.evaluation.samplers import EvaluatedSampler, open_policy

#: A gate's joint table has (K + 1)^members cells a condition.
MOST_MEMBERS = 8


def open_members(paths: Sequence[str | Path]) -> dict[str, EvaluatedSampler]:
    """The members by name: their runs' names where these differ, else with a number before them.

    Raises:
        FileNotFoundError: If there is no policy.
        ValueError: If there are fewer than two paths or too many, or two hold one checkpoint.
    """
    if not 2 <= len(paths) <= MOST_MEMBERS:
        raise ValueError(
            f"{len(paths)} member(s) given, expected 2 to {MOST_MEMBERS}: an ensemble disagrees in pairs, and counts "
            "the modes of all its members together"
        )
    names = [run_name(path) for path in paths]
    if len(set(names)) < len(names):
        names = [f"{number} {name}" for number, name in enumerate(names)]
    members: dict[str, EvaluatedSampler] = {}
    known: dict[str, str | Path] = {}
    for name, path in zip(names, paths, strict=True):
        members[name] = open_policy(path)
        checkpoint = members[name].provenance["checkpoint"]
        if checkpoint in known:
            raise ValueError(
                f"{known[checkpoint]} and {path} hold the same checkpoint, expected different members: leave one out"
            )
        known[checkpoint] = path
    return members
