"""Bad rollouts files, geometry cards and datasets: descriptions, columns and environments."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from cases import Case, Products, file_case, report, tree_case
from damage import Damage, binary_damages, byte_damages, doubled, edited, json_damages


def document_cases(products: Products) -> Iterator[Case]:
    rng = np.random.default_rng(2)
    whole = products.rollouts
    for what, damage in byte_damages(whole.stat().st_size, rng):
        yield file_case(f"rollouts: {what}", whole, damage, report)
    packed = whole.with_name("packed.rollouts.json.gz")
    packed.write_bytes(gzip.compress(whole.read_bytes(), mtime=0))
    for what, damage in byte_damages(packed.stat().st_size, np.random.default_rng(3)):
        yield file_case(f"compressed rollouts: {what}", packed, damage, report)
    yield file_case("rollouts: a field given twice", whole, doubled, report)
    document = json.loads(whole.read_text())
    free = ("policy", "partition.parameters", "env_kwargs", "outcomes.0.seed", "held_pairs")
    for what, change in json_damages(document, rng, free=free, most=60):
        if what.removeprefix("no ") not in OPTIONAL:
            yield file_case(f"rollouts: {what}", whole, edited(change), report)
    card = products.data / "card.json"
    for what, damage in byte_damages(card.stat().st_size, rng):
        yield _card_case(what, card, damage)
    free = ("single_feature",)
    for what, change in json_damages(json.loads(card.read_text()), rng, free=free, most=40):
        if not what.startswith(("no measured.", "no paper.", "no meanings.")) and ".stranger" not in what:
            yield _card_case(what, card, edited(change))


#: Fields that a description may leave out.
OPTIONAL = [
    "policy",
    "split",
    "seed",
    "conditions_seed",
    "rejections",
    "mode_probabilities",
    "horizon",
    "env_kwargs",
    "held_pairs",
    "frames",
    "refused",
    "failure",
    "onset",
    "outcomes.0.frames",
    "outcomes.0.refused",
    "outcomes.0.failure",
    "outcomes.0.onset",
]


def _card_case(what: str, card: Path, damage: Damage) -> Case:
    return file_case(f"card: {what}", card, damage, lambda path: report(path.parent))


def dataset_cases(products: Products) -> Iterator[Case]:
    rng = np.random.default_rng(3)
    whole = products.data / "test"

    def evaluated(folder: Path) -> list[str]:
        output = str(folder.parent / "out.gate.json")
        return ["evaluate", "--exact", "--dataset", str(folder), "--pairs", "2", "--output", output]

    for file, options in DESCRIPTIONS.items():
        text = (whole / file).read_text()
        for what, damage in byte_damages(len(text), rng):
            yield tree_case(f"{file}: {what}", whole, file, damage, evaluated)
        yield tree_case(f"{file}: a field given twice", whole, file, doubled, evaluated)
        for what, change in json_damages(json.loads(text), rng, most=40, **options):
            if what.removeprefix("no ") not in OPTIONAL:
                yield tree_case(f"{file}: {what}", whole, file, edited(change), evaluated, whole.name, "input")
    data = "data/chunk-000/file-000.parquet"
    for what, damage in binary_damages((whole / data).stat().st_size, rng):
        yield tree_case(f"data: {what}", whole, data, damage, evaluated)
    for where in rng.integers(4, (whole / data).stat().st_size // 2, size=12):
        yield tree_case(f"data: a flipped bit at {where}", whole, data, _flipped(int(where)), evaluated)
    for what, change in COLUMNS.items():
        yield tree_case(f"data: {what}", whole, data, _recolumned(change), evaluated, "input")
    for what, change in ENVIRONMENTS.items():
        file = "meta/dualhead.json"
        yield tree_case(f"{file}: {what}", whole, file, edited(change), evaluated, "input")


DESCRIPTIONS: dict[str, dict[str, Any]] = {
    "meta/info.json": {
        "closed": False,
        "free": [
            "total_tasks",
            "chunks_size",
            "data_files_size_in_mb",
            "video_files_size_in_mb",
            "data_path",
            "video_path",
            "robot_type",
            "splits",
            "features.observation.state.names",
            "features.observation.environment_state.names",
            "features.task_index",
            "features.timestamp",
            "features.index.names",
            "features.mode.names",
            "features.pair.names",
            "features.branch_step.names",
            "features.frame_index.names",
            "features.episode_index.names",
        ],
    },
    "meta/dualhead.json": {
        "free": ("env_kwargs", "partition.parameters", "seed", "conditions_seed", "rejections", "split", "horizon")
    },
}


def _numbers(columns: dict[str, Any], name: str) -> np.ndarray:
    return columns[name].to_numpy().copy()


def _set(name: str, frame: int, value: int) -> Callable[[dict[str, Any]], None]:
    def change(columns: dict[str, Any]) -> None:
        values = _numbers(columns, name)
        values[frame] = value
        columns[name] = values

    return change


def _rows(rows: Callable[[int], np.ndarray]) -> Callable[[dict[str, Any]], None]:
    def change(columns: dict[str, Any]) -> None:
        chosen = pa.array(rows(len(columns["index"])))
        for name in columns:
            columns[name] = columns[name].take(chosen)

    return change


def _constant(name: str, value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda columns: columns.update({name: [value] * len(columns["index"])})


COLUMNS: dict[str, Callable[[dict[str, Any]], None]] = {
    "rows that are missing": _rows(lambda n: np.arange(n - 3)),
    "no row": _rows(lambda n: np.arange(0)),
    "a row given twice": _rows(lambda n: np.r_[0, np.arange(n - 1)]),
    "all rows given twice": _rows(lambda n: np.r_[np.arange(n), np.arange(n)]),
    "a mode that does not exist": _set("mode", 0, 9),
    "a negative pair": _set("pair", 0, -3),
    "a branch beyond the episode": _set("branch_step", 0, 500),
    "an episode out of order": _set("episode_index", 4, 7),
    "a frame out of order": _set("frame_index", 4, 1),
    "an index out of order": _set("index", 4, 1),
    "a negative index": _set("index", 0, -1),
    "modes as words": _constant("mode", "left"),
    "modes as floats": _constant("mode", 0.5),
    "no modes": _constant("mode", None),
    "states of one number": _constant("observation.state", 1.0),
    "states of words": _constant("observation.state", ["a", "b"]),
    "states of three numbers": _constant("observation.state", [1.0, 2.0, 3.0]),
    "states without numbers": _constant("observation.state", [float("nan"), 1.0]),
    "an infinite condition": _constant("observation.environment_state", [1.0, 0.0, float("inf")]),
    "actions of nothing": _constant("action", []),
    "actions that are empty": _constant("action", None),
    "no action": lambda columns: columns.pop("action") and None,
    "no index": lambda columns: columns.pop("index") and None,
    "no condition": lambda columns: columns.pop("observation.environment_state") and None,
}
ENVIRONMENTS: dict[str, Callable[[Any], None]] = {
    "another package's environment": lambda card: card.update(env_id="os:system"),
    "another environment": lambda card: card.update(env_id="CartPole-v1"),
    "an environment that is not registered": lambda card: card.update(env_id="RotatingRing-v77"),
    "an unknown argument": lambda card: card["env_kwargs"].update(colour="red"),
    "an impossible argument": lambda card: card["env_kwargs"].update(path_spread=-1.0),
    "an argument of another type": lambda card: card["env_kwargs"].update(tau="high"),
    "another representation": lambda card: card["env_kwargs"].update(representation="elbow"),
    "probabilities of other modes": lambda card: card.update(mode_probabilities=[0.5, 0.3, 0.2]),
    "probabilities beyond one": lambda card: card.update(mode_probabilities=[0.5, 0.9]),
    "another layout": lambda card: card.update(layout="panda"),
    "an unknown layout": lambda card: card.update(layout="elbow"),
    "rollouts": lambda card: card.update(format="dualhead-rollouts/1"),
}


def _recolumned(change: Callable[[dict[str, Any]], None]) -> Damage:
    def apply(path: Path) -> None:
        table = pq.read_table(path)
        columns: dict[str, Any] = {name: table.column(name) for name in table.column_names}
        change(columns)
        pq.write_table(pa.table(columns), path)

    return apply


def _flipped(where: int) -> Damage:
    def apply(path: Path) -> None:
        whole = bytearray(path.read_bytes())
        whole[where] ^= 0x10
        path.write_bytes(whole)

    return apply
