"""``sweep.json``: every run of a sweep, what it is, and how far it has come."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from pydantic import Field

from dualhead_envs.atomic_files import write_atomically
from dualhead_envs.validated_json import Schema, read_validated
from dualhead_policy.training.checkpoints import last_step
from dualhead_policy.training.sweep.grouping import PlannedRun, make_groups

MANIFEST_FILE = "sweep.json"

State = Literal["waiting", "finished", "failed"]


class RunRecord(Schema):
    """A run of a sweep.

    Attributes:
        fingerprint: Of its configuration and data; a run never goes on under another.
        group: The group that it trains in.
        steps: Its budget.
        state: ``"waiting"`` (for its end), ``"finished"`` or ``"failed"``.
        step: Step of its last complete checkpoint.
        error: Why it failed.
    """

    fingerprint: str
    group: str
    steps: int = Field(ge=1)
    state: State = "waiting"
    step: int = Field(default=0, ge=0)
    error: str | None = None


class Manifest(Schema):
    """The content of ``sweep.json``."""

    version: Literal[1] = 1
    runs: dict[str, RunRecord]

    def groups(self) -> dict[str, list[str]]:
        """Names of the runs of every group."""
        groups: dict[str, list[str]] = {}
        for name, record in self.runs.items():
            groups.setdefault(record.group, []).append(name)
        return groups

    def unfinished(self) -> dict[str, RunRecord]:
        """What a sweep still lacks, by the run's name; each run's folder lies under the sweep's by that name."""
        return {name: record for name, record in self.runs.items() if record.state != "finished"}

    def updated(self, changes: Mapping[str, Mapping[str, object]]) -> Manifest:
        """This manifest with fields of some runs changed."""
        runs = {name: record.model_copy(update=dict(changes.get(name, {}))) for name, record in self.runs.items()}
        return self.model_copy(update={"runs": runs})

    def as_found(self, output: Path) -> Manifest:
        """This manifest with every run's step, and whether it has finished, as its checkpoints say."""
        changes: dict[str, dict[str, object]] = {}
        for name, record in self.runs.items():
            changes[name] = {"step": last_step(output / name)}
            if changes[name]["step"] == record.steps:
                changes[name] |= {"state": "finished", "error": None}
            elif record.state == "finished":
                changes[name] |= {"state": "waiting"}
        return self.updated(changes)

    def write(self, output: Path) -> None:
        """Write it into the sweep's folder, in one step."""
        write_atomically(output / MANIFEST_FILE, self.model_dump_json(indent=1))


def read_manifest(output: Path) -> Manifest | None:
    """The manifest of a sweep's folder, or None if there is none.

    Raises:
        ValueError: If it is damaged.
    """
    path = output / MANIFEST_FILE
    if not path.is_file():
        return None
    remedy = "delete it to have it written anew from the runs' checkpoints"
    return read_validated(path, Manifest, kind="a sweep's manifest", remedy=remedy)


def continue_manifest(before: Manifest | None, runs: Sequence[PlannedRun], *, size: int, jobs: int) -> Manifest:
    """The manifest of a sweep: what was known of it, and its new runs in groups of their own.

    Args:
        before: The manifest of an earlier command, or None.
        runs: Every run of the sweep's file.
        size: Largest group.
        jobs: Groups at a time.

    Raises:
        ValueError: If a run was begun with another configuration or other data.
    """
    known = {} if before is None else dict(before.runs)
    for planned in runs:
        record = known.get(planned.run.name)
        if record is not None and record.fingerprint != planned.fingerprint:
            raise ValueError(
                f"run {planned.run.name} was begun with another configuration or other data than the sweep's file now "
                "says: restore them, or give the sweep another output"
            )
    new = [planned for planned in runs if planned.run.name not in known]
    first = len({record.group for record in known.values()})
    for index, group in enumerate(make_groups(new, size=size, jobs=jobs)):
        for planned in group:
            known[planned.run.name] = RunRecord(
                fingerprint=planned.fingerprint, group=f"group-{first + index:03d}", steps=planned.steps
            )
    names = {planned.run.name for planned in runs}
    # Runs that the file no longer has keep their checkpoints, and the manifest keeps what it knows of them.
    order = [*(planned.run.name for planned in runs), *(name for name in known if name not in names)]
    return Manifest(runs={name: known[name] for name in order})
