"""The groups of a sweep train on a cluster: a real one of two workers, which the test starts and stops."""

from __future__ import annotations

import pytest
import yaml

from dualhead_eval.cli import main
from dualhead_policy.training.checkpoints import last_step

FLAGS = {"steps": 4, "save_freq": 4, "batch_size": 16, "policy.device": "cpu", "policy.velocity_width": 16}


def write_sweep(folder, ring_data):
    content = {
        "output": str(folder / "sweep"),
        "datasets": {"ring": str(ring_data / "train")},
        "configurations": [{"name": "A"}],
        "seeds": [0, 1],
        "flags": FLAGS,
    }
    path = folder / "sweep.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.mark.cluster
def test_a_sweep_trains_on_a_dask_cluster_of_two_workers(ring_data, tmp_path):
    distributed = pytest.importorskip("distributed", reason="needs the extra: uv run --extra dask pytest -m cluster")
    path = write_sweep(tmp_path, ring_data)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        arguments = [str(path), "--backend", "dask", "--address", address, "--jobs", "2", "--no-progress"]
        assert main(["sweep", *arguments]) == 0
    assert [last_step(tmp_path / "sweep" / "ring" / "A" / f"seed-{seed}") for seed in (0, 1)] == [4, 4]


@pytest.mark.cluster
def test_an_unreachable_cluster_is_said_in_one_sentence(ring_data, tmp_path, capsys):
    pytest.importorskip("distributed", reason="needs the extra: uv run --extra dask pytest -m cluster")
    arguments = [str(write_sweep(tmp_path, ring_data)), "--backend", "dask", "--address", "tcp://127.0.0.1:9"]
    assert main(["sweep", *arguments, "--no-progress"]) == 2
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in capsys.readouterr().err


def test_a_cluster_without_an_address_is_refused(ring_data, tmp_path, capsys):
    assert main(["sweep", str(write_sweep(tmp_path, ring_data)), "--backend", "dask"]) == 2
    assert "--backend dask needs its scheduler: give --address" in capsys.readouterr().err
