"""Staging of finished episodes in shards that are either whole or absent.

A recording can be killed at any moment: a shard is written to a temporary name, flushed to the disk and
renamed, so that what is listed can be trusted and what is missing is recorded again.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from dualhead_envs.atomic_files import write_atomically
from dualhead_envs.recording.claim import claimed, discard
from dualhead_envs.recording.episode import Episode

_FRAME_COLUMNS = ("observation_state", "environment_state", "action")
_EPISODE_COLUMNS = ("mode", "pair", "branch_step")


class ShardStore:
    """A staging folder of shards, owned by one process at a time.

    Use as a context manager: entering locks the folder and creates it if need be; leaving unlocks it (as
    does the end of the process, however it ends).

    Args:
        folder: The staging folder.
        configuration: All that determines the episodes, as JSON; shards of another one are refused.

    Raises:
        BlockingIOError: On entering, if another process holds the folder.
        FileExistsError: On entering, if the folder holds shards of another configuration.
    """

    def __init__(self, folder: Path, configuration: Mapping[str, Any]):
        self.folder = Path(folder)
        self.configuration = json.loads(json.dumps(configuration))
        self._claim = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as claim:
            claim.enter_context(claimed(self.folder))
            self._prepare()
            self._claim = claim.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._claim.close()

    def names(self) -> list[str]:
        """Names of the finished shards, sorted."""
        return sorted(path.stem for path in self.folder.glob("*.npz"))

    def write(self, name: str, episodes: Sequence[Episode]) -> None:
        """Write ``episodes`` as the shard ``name``, whole or not at all.

        Raises:
            ValueError: If the episodes do not all have the same extra columns.
        """
        extras = [tuple(episode.extra) for episode in episodes]
        if len(set(extras)) > 1:
            raise ValueError(f"shard {name} has episodes with different extra columns: {sorted(set(extras))}")
        columns = {
            key: np.concatenate([np.asarray(getattr(episode, key), np.float32) for episode in episodes])
            for key in _FRAME_COLUMNS
            if episodes
        }
        columns["length"] = np.array([len(episode) for episode in episodes], dtype=np.int64)
        for key in _EPISODE_COLUMNS:
            columns[key] = np.array([getattr(episode, key) for episode in episodes], dtype=np.int64)
        for key in extras[0] if extras else ():
            columns[f"extra.{key}"] = np.array([episode.extra[key] for episode in episodes], dtype=np.float64)
        archive = io.BytesIO()
        np.savez(archive, allow_pickle=False, **columns)
        write_atomically(self.folder / f"{name}.npz", archive.getvalue())

    def read(self, name: str) -> list[Episode]:
        """The episodes of the finished shard ``name``.

        Raises:
            FileNotFoundError: If there is no such shard.
            ValueError: If the file is damaged.
        """
        path = self.folder / f"{name}.npz"
        try:
            with np.load(path, allow_pickle=False) as archive:
                columns = dict(archive)
        except (zipfile.BadZipFile, EOFError, ValueError, OSError) as error:
            if isinstance(error, FileNotFoundError):
                raise
            raise ValueError(f"{path} is damaged ({error}): delete it and record again") from error
        if not len(columns["length"]):
            return []
        bounds = np.cumsum(columns["length"])[:-1]
        frames = {key: np.split(columns[key], bounds) for key in _FRAME_COLUMNS}
        extra = {key.removeprefix("extra."): values for key, values in columns.items() if key.startswith("extra.")}
        return [
            Episode(
                frames["observation_state"][i],
                frames["environment_state"][i],
                frames["action"][i],
                mode=int(columns["mode"][i]),
                pair=int(columns["pair"][i]),
                branch_step=int(columns["branch_step"][i]),
                extra={key: float(values[i]) for key, values in extra.items()},
            )
            for i in range(len(columns["length"]))
        ]

    def discard(self) -> None:
        """Delete the staging folder; the store is of no further use."""
        discard(self.folder)

    def _prepare(self) -> None:
        path = self.folder / "configuration.json"
        if path.exists() and self.names():
            found = json.loads(path.read_text())
            if found != self.configuration:
                keys = sorted(
                    key
                    for key in found.keys() | self.configuration.keys()
                    if found.get(key) != self.configuration.get(key)
                )
                raise FileExistsError(
                    f"{self.folder} holds an unfinished recording with another {', '.join(keys)}: "
                    "repeat its arguments to finish it, or delete the folder to start afresh"
                )
        else:
            write_atomically(path, json.dumps(self.configuration, indent=2) + "\n")
        for leftover in self.folder.glob("*.partial"):
            leftover.unlink()
