"""Two prediction columns of any LeRobotDataset, to a gate."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dualhead_eval.cli import main
from dualhead_eval.evaluation.prediction_columns import prediction_gate, read_predictions
from dualhead_eval.gate.file import read_gate
from dualhead_eval.partitions.scored import ScoredPartition
from dualhead_eval.partitions.side import SidePartition

SIDES = SidePartition([0, 1], tau=0.5)
DECIDED = np.array([1, 0, 1, 1, 0, 1], dtype=bool)


def write_dataset(root: Path, *, nested: bool = False, bad: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """A dataset of 6 frames in 2 episodes whose decisions predict 4 paths of 3 points by each of two heads."""
    rng = np.random.default_rng(0)
    paths = rng.normal(size=(2, 6, 4, 3, 2)).astype(np.float32)
    if bad:
        paths[0, 2, 0] = np.nan
    columns = {
        "index": np.arange(6),
        "episode_index": np.array([0, 0, 0, 1, 1, 1]),
        "prediction.decision": DECIDED,
        "observation.environment_state": list(rng.normal(size=(6, 5)).astype(np.float32)),
    }
    kinds = {"index": "int64", "episode_index": "int64", "prediction.decision": "bool"}
    features = {name: {"dtype": dtype, "shape": [1]} for name, dtype in kinds.items()}
    features["observation.environment_state"] = {"dtype": "float32", "shape": [5]}
    shape = [4, 3, 2] if nested else [24]
    for name, path in zip(("prediction.a", "prediction.b"), paths, strict=True):
        columns[name] = path.tolist() if nested else list(path.reshape(6, -1))
        features[name] = {"dtype": "float32", "shape": shape}
    features["prediction.narrow"] = {"dtype": "float32", "shape": [12]}
    columns["prediction.narrow"] = list(paths[0].reshape(6, -1)[:, :12])
    (root / "data" / "chunk-000").mkdir(parents=True)
    (root / "meta").mkdir()
    table = pa.table({name: pa.array(values) for name, values in columns.items()})
    for name in ("prediction.a", "prediction.b") if nested else ():
        kind = pa.list_(pa.list_(pa.list_(pa.float32())))
        table = table.set_column(table.schema.get_field_index(name), name, table.column(name).cast(kind))
    pq.write_table(table, root / "data" / "chunk-000" / "file-000.parquet")
    info = {"codebase_version": "v3.0", "fps": 10, "total_episodes": 2, "total_frames": 6, "features": features}
    (root / "meta" / "info.json").write_text(json.dumps(info))
    return paths[0], paths[1]


@pytest.mark.parametrize("nested", [False, True])
def test_every_pair_of_every_decision_is_counted(nested, tmp_path):
    a, b = write_dataset(tmp_path / "d", nested=nested)
    sizes = {} if nested else {"samples": 4, "horizon": 3}
    predictions = read_predictions(tmp_path / "d", ["prediction.a", "prediction.b"], **sizes)
    gate = prediction_gate(predictions, ScoredPartition(SIDES), taus=[1.0], metres=True, label="mine")
    for tau in (0.5, 1.0):
        label_a, label_b = SIDES.assign(a, tau=tau)[DECIDED], SIDES.assign(b, tau=tau)[DECIDED]
        for decision, table in enumerate(gate.pair_table(tau=tau)):
            pairs = list(zip(label_a[decision], label_b[decision], strict=True))
            assert all(table[i, j] == pairs.count((i, j)) for i in (-1, 0, 1) for j in (-1, 0, 1))
    assert gate.pair_ids.tolist() == [0, 0, 1, 1]
    assert gate.heads == ("a", "b")
    assert gate.conditions.shape == (4, 5)
    assert gate.partition == SIDES.to_dict()
    assert gate.strata["position"].unit == "mm"


def test_the_command_writes_that_gate(tmp_path, capsys):
    write_dataset(tmp_path / "d")
    (tmp_path / "side.json").write_text(json.dumps(SIDES.to_dict()))
    arguments = ["--columns", "prediction.a", "prediction.b", "--samples", "4", "--horizon", "3"]
    output = tmp_path / "mine.gate.json"
    paths = ["--dataset", str(tmp_path / "d"), "--partition", str(tmp_path / "side.json"), "--output", str(output)]
    assert main(["evaluate", *arguments, *paths, "--tau", "1"]) == 0
    gate = read_gate(output)
    assert gate.taus == [0.5, 1.0]
    assert gate.pair_table().sum() == 16
    assert gate.strata == {}
    assert "mine" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("columns", "options", "sentence"),
    [
        (["prediction.a", "prediction.c"], ["--horizon", "3"], "no feature 'prediction.c'"),
        (["prediction.a", "prediction.a"], ["--horizon", "3"], "two different features"),
        (["prediction.a", "prediction.b"], [], "give --horizon"),
        (["prediction.a", "prediction.b"], ["--horizon", "5"], "multiple of"),
        (["prediction.a", "prediction.b"], ["--horizon", "0"], "multiple of"),
        (["prediction.a", "prediction.narrow"], ["--horizon", "3"], "expected the same"),
        (["prediction.a", "prediction.b"], ["--horizon", "3"], "expected (..., H, 2)"),
        (
            ["prediction.a", "prediction.b"],
            ["--horizon", "3", "--pairs", "4"],
            "give --policy or --pair or --exact instead",
        ),
        (["prediction.b", "prediction.a"], ["--horizon", "3", "--samples", "4"], "not finite"),
    ],
)
def test_what_cannot_be_read_is_one_sentence(columns, options, sentence, tmp_path, capsys):
    write_dataset(tmp_path / "d", bad="not finite" in sentence)
    (tmp_path / "side.json").write_text(json.dumps(SIDES.to_dict()))
    paths = ["--dataset", str(tmp_path / "d"), "--partition", str(tmp_path / "side.json")]
    output = tmp_path / "g.json"
    assert main(["evaluate", "--columns", *columns, *options, *paths, "--output", str(output)]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert not output.exists()


def test_a_partition_is_asked_for(tmp_path, capsys):
    write_dataset(tmp_path / "d")
    arguments = ["evaluate", "--columns", "prediction.a", "prediction.b", "--output", str(tmp_path / "g.json")]
    assert main(arguments) == 2
    assert "--dataset is missing" in capsys.readouterr().err
    assert main([*arguments, "--dataset", str(tmp_path / "d")]) == 2
    assert "--partition is missing" in capsys.readouterr().err
