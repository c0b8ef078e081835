"""The fast trainer does what lerobot-train does, and refuses what it cannot do; tests/faults has kills and resumes."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
import torch
from safetensors.torch import load_file

from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.checkpoints import last_checkpoint
from dualhead_policy.training.fresh_ring_paths import FreshRingPaths
from dualhead_policy.training.provenance import training_summary
from dualhead_policy.training.trainer import Training

SMALL = ["--batch_size=32", "--policy.device=cpu", "--policy.velocity_width=64", "--policy.encoder_dim=32"]


def flags(ring_data, output, *more):
    return [f"--dataset.root={ring_data / 'train'}", f"--output_dir={output}", *SMALL, *more]


def weights(output):
    return load_file(last_checkpoint(output) / "pretrained_model" / "model.safetensors")


#: What the console script `lerobot-train` does, for one set of flags after the other; it never names this package.
LEROBOT_TRAIN = """
import json, sys
from lerobot.scripts.lerobot_train import main
for flags in json.loads(sys.argv[1]):
    sys.argv = ["lerobot-train", *flags]
    main()
"""


def assert_both_trainers_agree(data, folder, mechanisms):
    """Train every mechanism by LeRobot, in a process of its own in another folder, and by ours."""
    runs = {
        trainer: [
            flags(data, folder / f"{trainer}-{i}", "--steps=12", "--seed=3", *more) for i, more in enumerate(mechanisms)
        ]
        for trainer in ("theirs", "ours")
    }
    own = ["--policy.type=dualhead", "--dataset.repo_id=local/data", "--num_workers=0", "--env_eval_freq=0"]
    asked = json.dumps([[*own, "--save_freq=12", *run] for run in runs["theirs"]])
    done = subprocess.run(
        [sys.executable, "-c", LEROBOT_TRAIN, asked], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    for i, run in enumerate(runs["ours"]):
        Training(parse_training_config(run, None)).run()
        theirs, ours = weights(folder / f"theirs-{i}"), weights(folder / f"ours-{i}")
        assert set(theirs) == set(ours)
        for name, value in theirs.items():
            # The fast trainer fuses Adam's arithmetic; nothing else differs.
            assert torch.allclose(value.float(), ours[name].float(), atol=1e-6), name


def test_lerobot_train_writes_the_same_policy_from_another_folder(ring_data, tmp_path):
    assert_both_trainers_agree(
        ring_data, tmp_path, [[], ["--policy.token=oracle", "--policy.token_replacement_prob=0.1"]]
    )


@pytest.mark.slow
def test_lerobot_train_writes_the_same_robot_policy(panda_data, tmp_path):
    """Padded windows, noise on the observation, gripper, frames and mechanisms included."""
    mechanisms = [
        ["--policy.token=episode", "--policy.token_draw=learned", "--policy.consistency_weight=1"],
        ["--policy.latent=posterior", "--policy.rotation_head=true", "--policy.rotation_consistency_weight=1"],
    ]
    assert_both_trainers_agree(panda_data, tmp_path, mechanisms)


def test_residual_and_latents_influence_are_logged(ring_data, tmp_path):
    more = ["--steps=3", "--save_freq=3", "--policy.latent=prior"]
    Training(parse_training_config(flags(ring_data, tmp_path / "run", *more), None)).run()
    line = json.loads((tmp_path / "run" / "training_log.jsonl").read_text().splitlines()[0])
    assert set(line["latent_sensitivity"]) == {"joint", "position"}
    assert all(change > 0 for change in line["latent_sensitivity"].values())
    assert line["residual"]["position_mm"] > 0


def test_fresh_paths_never_repeat_and_depend_on_the_step_alone(ring_data, tmp_path):
    cfg = parse_training_config(flags(ring_data, tmp_path / "fresh", "--steps=5"), None)
    source = Training(cfg, fresh_paths=True).source
    first, second = source.batch(0), source.batch(1)
    assert not torch.equal(first.action, second.action)
    assert torch.equal(source.batch(0).action, first.action)


def test_a_resumed_run_goes_on_with_fresh_paths_and_its_checkpoint_says_so(ring_data, tmp_path):
    output = tmp_path / "fresh"
    cfg = parse_training_config(flags(ring_data, output, "--steps=4", "--save_freq=2"), None)
    saved = Training(cfg, fresh_paths=True).run()
    assert training_summary(saved)["fresh_paths"] is True
    resumed = parse_training_config(["--resume=true", f"--output_dir={output}", "--steps=6"], None)
    assert isinstance(Training(resumed).source, FreshRingPaths)


def test_recorded_windows_are_not_exchanged_for_fresh_paths_on_resuming(ring_data, tmp_path):
    output = tmp_path / "recorded"
    saved = Training(parse_training_config(flags(ring_data, output, "--steps=2", "--save_freq=2"), None)).run()
    summary = training_summary(saved)
    assert (summary["steps"], summary["batch_size"], summary["fresh_paths"]) == (2, 32, False)
    resumed = parse_training_config(["--resume=true", f"--output_dir={output}", "--steps=4"], None)
    with pytest.raises(ValueError, match="resume it without --fresh_paths"):
        Training(resumed, fresh_paths=True)


def test_an_epoch_visits_every_window_once(ring_data, tmp_path):
    training = Training(parse_training_config(flags(ring_data, tmp_path / "run", "--steps=5"), None))
    seen = torch.cat([training.source.batch(step).action for step in range(training.source.order.batches_per_epoch)])
    assert len(torch.unique(seen.flatten(1), dim=0)) == len(seen) == 256


@pytest.mark.parametrize(
    ("arguments", "error", "sentence"),
    [
        (["--policy.colour=red"], ValueError, "colour"),
        (["--policy.source_noise_beta=2"], ValueError, "outside"),
        (["--stepps=3"], ValueError, "stepps"),
        (["--steps=many"], ValueError, "steps"),
    ],
)
def test_wrong_flags_are_refused_in_one_sentence(ring_data, tmp_path, arguments, error, sentence):
    with pytest.raises(error, match=sentence):
        parse_training_config(flags(ring_data, tmp_path / "run", *arguments), None)
    assert not (tmp_path / "run").exists()


def test_a_folder_that_holds_a_run_is_not_overwritten(ring_data, trained):
    with pytest.raises(FileExistsError, match="--resume=true"):
        parse_training_config(flags(ring_data, trained), None)


def test_resuming_nothing_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no complete checkpoint"):
        parse_training_config(["--resume=true", f"--output_dir={tmp_path}"], None)


def test_a_missing_dataset_is_refused(tmp_path):
    cfg = parse_training_config([f"--dataset.root={tmp_path / 'none'}", f"--output_dir={tmp_path / 'run'}"], None)
    with pytest.raises(FileNotFoundError, match="not a LeRobotDataset"):
        Training(cfg)
