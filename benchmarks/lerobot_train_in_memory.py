"""`lerobot-train`, unmodified, with a state-only dataset's frames held in memory instead of fetched one by one.

    uv run --group benchmarks python benchmarks/lerobot_train_in_memory.py FLAGS OF LEROBOT-TRAIN
    uv run --group benchmarks python benchmarks/lerobot_train_in_memory.py --check FLAGS OF LEROBOT-TRAIN

The loop, optimiser, schedule, order of windows, random numbers and checkpoints are LeRobot's own; what a dataset's
item is made of alone is replaced. `--check` trains 20 steps both ways into temporary folders, and compares the weights
bit for bit.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import torch
from torch.utils.data import Dataset

CHECKED_STEPS = 20


class FramesInMemory(Dataset):
    """A LeRobotDataset without images, whose items come from memory.

    Args:
        dataset: The dataset; everything but its items is asked of it.

    Raises:
        ValueError: If it has images.
    """

    def __init__(self, dataset: Any) -> None:
        if dataset.meta.camera_keys:
            raise ValueError(f"the dataset has images ({dataset.meta.camera_keys}), expected states only")
        self.dataset = dataset
        # The indices of the windows are the reader's: the dataset itself keeps them as seconds.
        reader = dataset._ensure_reader()
        frames = reader.hf_dataset.with_format("numpy")[:]
        self.columns = {name: torch.from_numpy(column.copy()) for name, column in frames.items()}
        episodes = dataset.meta.episodes
        self.begin = torch.tensor(episodes["dataset_from_index"])
        self.end = torch.tensor(episodes["dataset_to_index"])
        self.steps = {key: torch.tensor(steps) for key, steps in reader.delta_indices.items()}
        self.tasks = list(dataset.meta.tasks.index)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["dataset"], name)

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, index: int) -> dict[str, Any]:
        item = {name: column[index] for name, column in self.columns.items()}
        episode = int(item["episode_index"])
        begin, end = int(self.begin[episode]), int(self.end[episode])
        for key, steps in self.steps.items():
            window = index + steps
            item[key] = self.columns[key][window.clamp(begin, end - 1)]
            item[f"{key}_is_pad"] = (window < begin) | (window >= end)
        item["task"] = self.tasks[int(item["task_index"])]
        return item


def train(flags: list[str]) -> None:
    """Run ``lerobot-train`` with ``flags`` on frames in memory."""
    from lerobot.scripts import lerobot_train

    make = lerobot_train.make_train_eval_datasets

    def make_in_memory(cfg: Any) -> tuple[Any, Any]:
        dataset, held_out = make(cfg)
        return FramesInMemory(dataset), held_out

    lerobot_train.make_train_eval_datasets = make_in_memory
    sys.argv = ["lerobot-train", *flags]
    lerobot_train.main()


def check(flags: list[str]) -> None:
    """Train a few steps both ways and compare every weight."""
    from safetensors.torch import load_file

    ours = [sys.executable, __file__]
    theirs = [str(Path(sys.executable).with_name("lerobot-train"))]
    weights = []
    with tempfile.TemporaryDirectory() as folder:
        for name, command in (("in-memory", ours), ("lerobot-train", theirs)):
            output = Path(folder) / name
            extra = [f"--steps={CHECKED_STEPS}", f"--output_dir={output}", f"--save_freq={CHECKED_STEPS}"]
            kept = [flag for flag in flags if flag.split("=")[0] not in ("--steps", "--output_dir", "--save_freq")]
            subprocess.run([*command, *kept, *extra], check=True, capture_output=True)
            saved = output / "checkpoints" / "last" / "pretrained_model" / "model.safetensors"
            weights.append(load_file(saved))
    first, second = weights
    different = [name for name in first if not torch.equal(first[name], second[name])]
    if first.keys() != second.keys() or different:
        raise SystemExit(
            f"after {CHECKED_STEPS} steps {len(different)} of {len(first)} tensors differ: {different[:5]}"
        )
    print(f"after {CHECKED_STEPS} steps all {len(first)} tensors are those of lerobot-train, bit for bit")


if __name__ == "__main__":
    given = sys.argv[1:]
    if "--check" in given:
        check([flag for flag in given if flag != "--check"])
    else:
        train(given)
