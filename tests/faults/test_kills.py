"""Commands that are killed at random moments: nothing is lost, nothing wrong is left, nobody goes on working."""

from __future__ import annotations

import json
import random
import signal
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from killed_commands import Command, digests

from dualhead_policy.training.checkpoints import last_checkpoint

SIGNALS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM)
STEPS = 60
#: Kills of one product before it may finish.
KILLS_IN_A_ROW = 4


@dataclass(frozen=True)
class Work:
    """A command, and what can be said of its product while and after it works.

    Attributes:
        arguments: The command that makes the product in a folder, or goes on with what a killed one left there.
        product: Digests of the finished product in a folder; None while there is none.
        progress: How far the work in a folder has come: it must never go back.
        single_files: Whether the product is several files, of which some may be there before the others.
    """

    arguments: Callable[[Path], list[str]]
    product: Callable[[Path], dict[str, str] | None]
    progress: Callable[[Path], float] = lambda folder: 0
    single_files: bool = False


def recording(folder):
    root = ["--root", str(folder / "ring"), "--no-progress"]
    return ["record", "--representation", "nullspace", "--episodes", "3000", "--conditions", "40", *root]


def robot_recording(folder):
    size = ["--env", "v2", "--pairs", "3", "--workers", "2"]
    return ["record", *size, "--root", str(folder / "v2"), "--no-progress"]


def weights_and_steps(runs):
    """What can be said of the folders of some runs."""

    def product(folder):
        """Weights and training states of the last checkpoints; their configurations name the folder."""
        last = [last_checkpoint(folder / run) for run in runs]
        if any(checkpoint is None or int(checkpoint.name) < STEPS for checkpoint in last):
            return None
        found = [digests(path / "pretrained_model" / "model.safetensors", path / "training_state") for path in last]
        return {f"{run}/{name}": value for run, files in zip(runs, found, strict=True) for name, value in files.items()}

    def progress(folder):
        """Steps in complete checkpoints."""
        return sum(int(last.name) for run in runs if (last := last_checkpoint(folder / run)) is not None)

    return product, progress


def training(data, *more, runs=("run",)):
    def arguments(folder):
        run = f"--output_dir={folder / 'run'}"
        if more or last_checkpoint(folder / "run") is None:
            small = ["--batch_size=16", "--policy.velocity_width=32", "--policy.encoder_dim=16", "--policy.device=cpu"]
            budget = [f"--steps={STEPS}", "--save_freq=10", "--policy.token=window", *more]
            again = ["--resume=true"] if more and (folder / "run").exists() else []
            return ["train", f"--dataset.root={data / 'train'}", run, *budget, *small, *again]
        return ["train", "--resume=true", run]

    return Work(arguments, *weights_and_steps(runs))


def sweeping(data):
    runs = [f"sweep/ring/window/seed-{seed}" for seed in (0, 1)]

    def arguments(folder):
        flags = {"steps": STEPS, "save_freq": 10, "batch_size": 16, "policy.device": "cpu", "policy.token": "window"}
        sweep = {
            "output": str(folder / "sweep"),
            "datasets": {"ring": str(data / "train")},
            "configurations": [{"name": "window", "flags": {"policy.velocity_width": 32, "policy.encoder_dim": 16}}],
            "seeds": [0, 1],
            "flags": flags,
        }
        (folder / "sweep.yaml").write_text(json.dumps(sweep))  # JSON is YAML
        return ["sweep", str(folder / "sweep.yaml"), "--jobs", "1", "--no-progress"]

    return Work(arguments, *weights_and_steps(runs))


def studying(data):
    """A study of two runs on recorded data: its gate files are its product."""

    def arguments(folder):
        flags = {"batch_size": 16, "policy.device": "cpu", "policy.velocity_width": 32, "policy.encoder_dim": 16}
        floor = {"name": "floor", "test": "equivalence", "claim": "c", "criterion": "c", "rows": ["A"], "margin": 0.02}
        study = {
            "title": "small",
            "question": "Does it go on?",
            "datasets": {data.name: {"env": "RotatingRing-v2", "episodes": 1}},  # is there: nothing is recorded
            "banks": {"frozen": {"conditions": 4, "pairs": 32}},
            "flags": flags,
            "runs": [
                {
                    "importance": importance,
                    "configurations": [{"name": name}],
                    "seeds": [0],
                    "steps": STEPS,
                    "evaluate_at": [STEPS // 2, STEPS],
                }
                for importance, name in ((1, "A"), (2, "B"))
            ],
            "criteria": [floor],
        }
        (folder / "study.yaml").write_text(json.dumps(study))  # JSON is YAML
        places = ["--data", str(data.parent), "--runs", str(folder / "runs"), "--results", str(folder / "results")]
        return ["study", str(folder / "study.yaml"), *places, "--jobs", "1", "--no-progress"]

    def product(folder):
        whole = len(list(folder.glob("results/gates/**/*.gate.json.gz"))) == 4
        table = folder / "results" / "study" / "table.csv"
        return digests(folder / "results" / "gates", table) if whole and table.exists() else None

    def progress(folder):
        return len(list(folder.glob("runs/*/*/*/checkpoints/0*"))) + len(list(folder.glob("results/gates/**/*.gz")))

    return Work(arguments, product, progress)


def evaluation(policy, data):
    def arguments(folder):
        what = ["--policy", str(policy), "--dataset", str(data / "test"), "--pairs", "200", "--label", "run"]
        return ["evaluate", *what, "--output", str(folder / "run.gate.json")]

    return arguments


def rolling_out(policy, data):
    def arguments(folder):
        what = ["--policy", str(policy), "--dataset", str(data / "test"), "--label", "run", "--episodes", "4"]
        recorded = folder / "rollouts"
        if recorded.exists():  # killed between the two products
            return [
                "evaluate",
                "--rollouts",
                str(recorded),
                "--label",
                "run",
                "--output",
                str(folder / "run.gate.json"),
            ]
        return ["evaluate", *what, "--record", str(recorded), "--output", str(folder / "run.gate.json")]

    return arguments


def reporting(gate):
    def arguments(folder):
        outputs = ["--json", "numbers.json", "--html", "page.html", "--figure", "region.png"]
        named = [str(folder / name) if "." in name else name for name in outputs]
        return ["report", str(gate), *named, "--figures", str(folder / "figures"), "--overwrite"]

    return arguments


@pytest.fixture(scope="module")
def works(ring_data, trained, tmp_path_factory):
    """Every kind of work, by name."""
    gate = tmp_path_factory.mktemp("gates") / "run.gate.json"
    assert Command(evaluation(trained, ring_data)(gate.parent), gate.with_suffix(".log")).wait() == 0
    return {
        "record": Work(
            recording,
            lambda folder: digests(folder / "ring"),
            lambda folder: len(list(folder.glob(".ring.recording/*.npz"))) + 99 * (folder / "ring").exists(),
        ),
        "robot record": Work(
            robot_recording,
            lambda folder: digests(folder / "v2"),
            lambda folder: len(list(folder.glob(".v2.recording/*.npz"))) + 99 * (folder / "v2").exists(),
        ),
        "train": training(ring_data),
        "train seeds": training(ring_data, "--seeds", "0", "1", runs=("run/seed-0", "run/seed-1")),
        "sweep": sweeping(ring_data),
        "study": studying(ring_data),
        "evaluate": Work(evaluation(trained, ring_data), lambda folder: digests(folder / "run.gate.json")),
        "rollouts": Work(
            rolling_out(trained, ring_data),
            lambda folder: digests(folder / "rollouts"),
            lambda folder: (folder / "rollouts").exists(),
        ),
        "report": Work(
            reporting(gate),
            lambda folder: digests(*(folder / n for n in ("numbers.json", "page.html", "region.png", "figures"))),
            single_files=True,
        ),
    }


def finish(work, folder):
    command = Command(work.arguments(folder), folder / "log")
    assert command.wait() == 0, command.log.read_text()
    return work.product(folder)


def kill_at_random(work, folder, seconds, draw):
    """End the work in ``folder`` within ``seconds``; returns the signal, or None if it was done first."""
    command = Command(work.arguments(folder), folder / "log")
    if command.wait(draw.uniform(0, seconds)) is not None or not command.send(number := draw.choice(SIGNALS)):
        return None
    status, said = command.wait(60), command.log.read_text()
    assert status is not None, f"{number.name} did not end {work.arguments(folder)}"
    assert not command.orphans()
    if number == signal.SIGINT and status != 0:
        assert (status, said.count("Traceback"), said.splitlines()[-1:]) == (130, 0, ["dualhead: interrupted"]), said
    return number


def survive(work, folder, kills, draw):
    """Kill work in fresh folders ``kills`` times in all, let each finish, and compare; returns what was sent."""
    (folder / "whole").mkdir(parents=True)
    begin = time.monotonic()
    whole = finish(work, folder / "whole")
    seconds = time.monotonic() - begin
    assert whole is not None
    sent: list[signal.Signals] = []
    for product in range(10 * kills):
        if len(sent) >= kills:
            break
        cut = folder / f"cut-{product}"
        cut.mkdir()
        for _ in range(min(KILLS_IN_A_ROW, kills - len(sent))):
            before = work.progress(cut)
            number = kill_at_random(work, cut, seconds, draw)
            found = work.product(cut)
            assert work.progress(cut) >= before
            assert found in (None, whole) or (work.single_files and found.items() <= whole.items())
            if number is None:
                break
            sent.append(number)
        if work.product(cut) != whole:
            assert finish(work, cut) == whole
    return sent


@pytest.mark.parametrize("name", ["record", "train", "study"])
def test_killed_work_finishes_as_if_nothing_had_happened(works, tmp_path, name):
    assert len(survive(works[name], tmp_path, 2, random.Random(5))) == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kills"),
    [
        ("record", 25),
        ("train", 25),
        ("sweep", 10),
        ("study", 10),
        ("evaluate", 20),
        ("rollouts", 20),
        ("report", 15),
        ("robot record", 5),
        ("train seeds", 5),
    ],
)
def test_a_hundred_kills_lose_nothing_and_leave_nothing_wrong(works, tmp_path, name, kills):
    sent = survive(works[name], tmp_path, kills, random.Random(2026))
    print(f"{name}: {dict(Counter(number.name for number in sent))}")
    assert len(sent) >= kills
