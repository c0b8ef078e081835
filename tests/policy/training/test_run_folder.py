"""A run's folder: one process at a time, the data that it began with, and what a kill or a full disk leaves."""

from __future__ import annotations

import resource
from contextlib import contextmanager

import pytest
import torch
from safetensors.torch import load_file

from dualhead_envs.ring.record import record_ring
from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.checkpoints import last_checkpoint
from dualhead_policy.training.run import claimed_run, train_run
from dualhead_policy.training.trainer import Training


def flags(data, output, *more):
    small = ["--batch_size=16", "--policy.device=cpu", "--policy.velocity_width=32", "--policy.encoder_dim=16"]
    return [f"--dataset.root={data / 'train'}", f"--output_dir={output}", *small, *more]


def weights(output):
    return load_file(last_checkpoint(output) / "pretrained_model" / "model.safetensors")


@contextmanager
def files_no_larger_than(size):
    """The kernel's own limit, which a write beyond meets as it meets a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_resuming_on_other_data_than_the_run_began_with_is_refused(trained, tmp_path):
    other = record_ring(
        "RotatingRing-v2", tmp_path / "other", episodes=64, conditions=2, env_kwargs={"representation": "nullspace"}
    )
    resumed = ["--resume=true", f"--output_dir={trained}", f"--dataset.root={other / 'train'}", "--steps=31"]
    with pytest.raises(ValueError, match=r"other data .* resume with the data that the run began with"):
        Training(parse_training_config(resumed, None))


@pytest.mark.parametrize("more", [[], ["--resume=true"]], ids=["repeated", "resumed"])
def test_a_folder_without_a_complete_checkpoint_starts_again(ring_data, tmp_path, more):
    output = tmp_path / "run"
    unlinked = output / "checkpoints" / "000001"
    unlinked.mkdir(parents=True)
    (output / "training_log.jsonl").write_text('{"step": 1, "lo')
    train_run(flags(ring_data, output, "--steps=2", "--save_freq=2", *more))
    assert last_checkpoint(output).name == "000002"
    assert not unlinked.exists()
    assert len((output / "training_log.jsonl").read_text().splitlines()) == 1


def test_a_folder_that_holds_something_else_is_not_trained_into(ring_data, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(FileExistsError, match=r"holds thesis\.tex: give another --output_dir"):
        train_run(flags(ring_data, tmp_path, "--steps=1"))


def test_one_process_at_a_time_trains_into_a_folder(ring_data, tmp_path):
    output = tmp_path / "run"
    for arguments in (flags(ring_data, output), ["--resume=true", *flags(ring_data, output)]):
        with (
            claimed_run(output),
            pytest.raises(BlockingIOError, match="in use by another process: wait for it"),
        ):
            train_run(arguments)


def test_the_lock_of_a_dead_process_locks_nothing(ring_data, tmp_path):
    (tmp_path / ".run.training").mkdir()
    (tmp_path / ".run.training" / "lock").touch()
    train_run(flags(ring_data, tmp_path / "run", "--steps=1"))
    assert last_checkpoint(tmp_path / "run").name == "000001"
    assert not (tmp_path / ".run.training").exists()


def test_a_run_that_met_a_full_disk_goes_on_once_there_is_room(ring_data, tmp_path):
    more = ["--steps=4", "--save_freq=2", "--seed=3"]
    train_run(flags(ring_data, tmp_path / "whole", *more))
    training = Training(parse_training_config(flags(ring_data, tmp_path / "cut", *more), None))
    limits = files_no_larger_than(2_000)
    sentence = r"000004 could not be written .* the last complete checkpoint, 000002, stands"
    with pytest.raises(OSError, match=sentence):
        training.run(lambda step, _: limits.__enter__() if step == 3 else None)
    limits.__exit__(None, None, None)
    assert [path.name for path in (tmp_path / "cut" / "checkpoints").iterdir() if path.name != "last"] == ["000002"]
    train_run(["--resume=true", f"--output_dir={tmp_path / 'cut'}"])
    whole, cut = weights(tmp_path / "whole"), weights(tmp_path / "cut")
    assert all(torch.equal(whole[name], cut[name]) for name in whole)


def test_a_finished_run_is_left_as_it_is(trained):
    before = last_checkpoint(trained).stat().st_mtime_ns
    assert train_run(["--resume=true", f"--output_dir={trained}"]).parent == last_checkpoint(trained)
    assert last_checkpoint(trained).stat().st_mtime_ns == before


def test_going_back_to_an_earlier_checkpoint_gives_up_the_later_ones(ring_data, tmp_path):
    """A kill on the way must not find ``last`` at a checkpoint that is about to be replaced."""
    output = tmp_path / "run"
    train_run(flags(ring_data, output, "--steps=4", "--save_freq=2"))
    earlier = output / "checkpoints" / "000002" / "pretrained_model" / "train_config.json"
    training = Training(parse_training_config(["--resume=true", f"--config_path={earlier}"], None))
    seen = []
    training.run(lambda step, _: seen.append((step, last_checkpoint(output).name)))
    assert seen == [(3, "000002"), (4, "000002")]
    assert last_checkpoint(output).name == "000004"
