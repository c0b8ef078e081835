"""Which policies keep both ways round the obstacle, which choose one, which average the two into it.

    uv run --group benchmarks python benchmarks/multimodality.py train --env v2 --data data/v2
    uv run --group benchmarks python benchmarks/multimodality.py evaluate --env v2 --data data/v2
    uv run python benchmarks/multimodality.py table --env v2
    uv run --group benchmarks python benchmarks/multimodality.py figure --env v2 --data data/v2

LeRobot's policies are trained by `lerobot-train` with the frames in memory (`lerobot_train_in_memory.py`, which checks
itself), ours by `dualhead train`; all on the same demonstrations of BimodalBypass-v2 (`--env v2`) or RotatingBypass-v3
(`--env v3`). `evaluate` writes gate files and closed-loop outcomes to results/multimodality/ENV, `table` reads nothing
else. `--smoke` does all of it with a few steps, pairs and episodes, in RUNS. The criteria stand in
results/multimodality/README.md.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results" / "multimodality"
IMAGES = ROOT / "docs" / "images"
BATCH, SEED, LOG_FREQ = 64, 0, 250
#: A line of `lerobot-train` with its loss.
LOSS = re.compile(r"step:\S+ .*? loss:(\S+)")
#: Constant dimensions (rotations that hold still) would be blown up by a division by their standard deviation.
MAPPING = json.dumps(dict.fromkeys(["STATE", "ENV", "ACTION"], "MIN_MAX"))


@dataclass(frozen=True)
class Entry:
    """One policy of the benchmark.

    Attributes:
        name: Its run and its files.
        title: Its row.
        flags: What it is trained with.
        steps: Its budget.
        ours: Whether `dualhead train` trains it.
    """

    name: str
    title: str
    flags: tuple[str, ...]
    steps: int
    ours: bool = False


_ACT = (
    "--policy.type=act", "--policy.chunk_size=16", "--policy.n_action_steps=8", "--policy.dim_model=128",
    "--policy.n_heads=8", "--policy.dim_feedforward=512", "--policy.n_encoder_layers=2",
    "--policy.n_vae_encoder_layers=2", "--policy.optimizer_lr=1e-4", f"--policy.normalization_mapping={MAPPING}",
)  # fmt: skip
_DIFFUSION = (
    "--policy.type=diffusion", "--policy.n_obs_steps=2", "--policy.horizon=20", "--policy.n_action_steps=8",
    "--policy.drop_n_last_frames=11", "--policy.down_dims=[64,128]", "--policy.noise_scheduler_type=DDIM",
    "--policy.num_inference_steps=20", f"--policy.normalization_mapping={MAPPING}",
)  # fmt: skip


@dataclass(frozen=True)
class Task:
    """One environment of the benchmark.

    Attributes:
        name: Its short name, that of its configurations and results.
        view: From where the figure shows it.
        axes: Dimensions of a position that the figure shows to the right and upwards.
        labels: What they are called there.
        picture: The figure's file in docs/images.
    """

    name: str
    view: str
    axes: tuple[int, int]
    labels: tuple[str, str]
    picture: str

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Its policies."""
        ours = {"A_independent": "ours, A: nothing shared", "H_episode_token_uniform": "ours, H: episode token"}
        return (
            Entry("ACT", "ACT", _ACT, 4000),
            Entry("Diffusion", "Diffusion (DDIM)", _DIFFUSION, 5000),
            Entry("Diffusion_1e-3", "Diffusion (DDIM), rate 1e-3", (*_DIFFUSION, "--policy.optimizer_lr=1e-3"), 10000),
            *(
                Entry(name, title, (f"--config_path=configs/{self.name}/{name}.yaml",), 5000, True)
                for name, title in ours.items()
            ),
        )


TASKS = {
    task.name: task
    for task in (
        Task("v2", "from above", (1, 0), ("y (m)", "x (m), towards the goal"), "multimodality.png"),
        Task("v3", "along the way", (1, 2), ("y (m)", "z (m)"), "multimodality_v3.png"),
    )
}


@dataclass(frozen=True)
class Budget:
    """How much is done, and where it goes.

    Attributes:
        runs: Folder of the trained policies.
        results: Folder of what `table` reads.
        pairs: Pairs of draws per condition.
        episodes: Closed-loop episodes per control.
        steps: Training steps of every policy; None for each policy's own.
    """

    runs: Path
    results: Path
    pairs: int = 64
    episodes: int = 50
    steps: int | None = None

    def steps_of(self, entry: Entry) -> int:
        """Training steps of a policy."""
        return self.steps or entry.steps

    def checkpoint(self, entry: Entry) -> Path:
        """The checkpoint of a policy's budget."""
        return self.runs / entry.name / "checkpoints" / f"{self.steps_of(entry):06d}" / "pretrained_model"


def command(name: str) -> str:
    return str(Path(sys.executable).with_name(name))


def train(entry: Entry, data: Path, budget: Budget) -> None:
    """Train one policy, from its last checkpoint if it was interrupted; a finished run is kept."""
    runs, steps = budget.runs, budget.steps_of(entry)
    output = runs / entry.name
    if budget.checkpoint(entry).is_dir():
        print(f"{output} is there: kept")
        return
    if output.exists():
        resume(entry, output, budget)
        return
    runs.mkdir(parents=True, exist_ok=True)
    common = [
        f"--dataset.root={data / 'train'}", f"--output_dir={output}", f"--steps={steps}", f"--seed={SEED}",
        f"--batch_size={BATCH}", "--policy.device=cpu", "--save_freq=1000",
    ]  # fmt: skip
    if entry.ours:
        subprocess.run([command("dualhead"), "train", *entry.flags, *common], check=True)
        return
    theirs = [
        f"--dataset.repo_id=local/{data.name}", "--dataset.video_backend=pyav", "--policy.push_to_hub=false",
        "--num_workers=0", "--env_eval_freq=0", f"--log_freq={min(LOG_FREQ, steps)}",
    ]  # fmt: skip
    script = str(Path(__file__).with_name("lerobot_train_in_memory.py"))
    with (runs / f"{entry.name}.log").open("w") as log:
        subprocess.run([sys.executable, script, *entry.flags, *common, *theirs], check=True, stdout=log, stderr=log)


def resume(entry: Entry, output: Path, budget: Budget) -> None:
    """Go on with a training from its last checkpoint."""
    last = output / "checkpoints" / "last"
    if not last.is_dir():
        sys.exit(f"{output} holds no checkpoint to go on from: delete it, and repeat the command")
    print(f"{output} goes on from step {int(last.resolve().name):,}")
    if entry.ours:
        subprocess.run([command("dualhead"), "train", "--resume=true", f"--output_dir={output}"], check=True)
        return
    log = budget.runs / f"{entry.name}.log"
    printed = log.read_text().splitlines(keepends=True)
    losses = [number for number, line in enumerate(printed, 1) if LOSS.search(line)]
    done = int(last.resolve().name) // min(LOG_FREQ, budget.steps_of(entry))
    log.write_text("".join(printed[: losses[done - 1] if done else 0]))  # what came after is trained again
    script = str(Path(__file__).with_name("lerobot_train_in_memory.py"))
    config = last / "pretrained_model" / "train_config.json"
    with log.open("a") as file:
        again = [sys.executable, script, f"--config_path={config}", "--resume=true"]
        subprocess.run(again, check=True, stdout=file, stderr=file)


def write_training_log(entry: Entry, budget: Budget) -> None:
    """The losses that `lerobot-train` printed, where a gate file's provenance looks for them."""
    target, printed = budget.runs / entry.name / "training_log.jsonl", budget.runs / f"{entry.name}.log"
    every = min(LOG_FREQ, budget.steps_of(entry))
    if entry.ours or target.exists():
        return
    losses = LOSS.findall(printed.read_text())
    lines = [json.dumps({"step": (i + 1) * every, "loss": float(loss)}) for i, loss in enumerate(losses)]
    target.write_text("\n".join(lines) + "\n")


def evaluate(entry: Entry, data: Path, budget: Budget) -> None:
    """Draws under the test conditions, closed-loop episodes and costs of one policy; what is there is kept."""
    write_training_log(entry, budget)
    results = budget.results
    results.mkdir(parents=True, exist_ok=True)
    policy = ["--policy", str(budget.checkpoint(entry)), "--dataset", str(data / "test")]
    gate = results / f"{entry.name}.gate.json.gz"
    if not gate.exists():
        drawn = ["--draws", "position", "--pairs", str(budget.pairs), "--label", entry.name, "--output", str(gate)]
        subprocess.run([command("dualhead"), "evaluate", *policy, *drawn], check=True)
    for control in ("position", "joint"):
        outcomes = results / f"{entry.name}-{control}.rollouts.json"
        if outcomes.exists():
            continue
        record = budget.runs / f"{entry.name}-{control}"
        loop = ["--record", str(record), "--control", control, "--episodes", str(budget.episodes), "--samples", "2"]
        subprocess.run(
            [command("dualhead"), "evaluate", *policy, *loop, "--output", str(record) + ".gate.json"], check=True
        )
        shutil.copy(record / "meta" / "dualhead.json", outcomes)
    costs = results / f"{entry.name}.costs.json"
    if not costs.exists():
        costs.write_text(json.dumps(measured_costs(entry, data, budget), indent=2) + "\n")


def measured_costs(entry: Entry, data: Path, budget: Budget) -> dict[str, Any]:
    """Parameters, and processor milliseconds of a training step and of a decision, on one thread."""
    import torch

    from dualhead_eval.evaluation.conditions import open_conditions
    from dualhead_eval.evaluation.draws import HeadPaths, open_paths

    torch.set_num_threads(1)
    source: Any = open_paths(budget.checkpoint(entry), "position")
    one = open_conditions(data / "test", 1)
    decision = _milliseconds(lambda: source.paths(one, 1, source.default_nfe, 0), 20)
    policy = source.sampler.sampler if isinstance(source, HeadPaths) else source.policy.policy
    step = _milliseconds(_training_step(entry, data, policy, source), 20)
    count = sum(parameter.numel() for parameter in policy.parameters())
    return {"parameters": count, "decision_ms": round(decision, 1), "training_step_ms": round(step, 1), "batch": BATCH}


def _training_step(entry: Entry, data: Path, policy: Any, source: Any) -> Any:
    """One optimiser step on random windows of the training data's shapes."""
    import torch

    if entry.ours:
        from dualhead_policy.training.arguments import parse_training_config
        from dualhead_policy.training.trainer import Training

        flags = [f"--dataset.root={data / 'train'}", "--output_dir=unused", f"--batch_size={BATCH}", *entry.flags[1:]]
        config = ROOT / entry.flags[0].removeprefix("--config_path=")
        training = Training(parse_training_config([f"--config_path={config}", *flags, "--policy.device=cpu"], None))
        return lambda: training.update(training.source.batch(0))
    config = policy.config
    past = () if config.n_obs_steps == 1 else (config.n_obs_steps,)
    steps = getattr(config, "horizon", None) or config.chunk_size
    batch = {key: torch.randn(BATCH, *past, *shape) for key, shape in source.policy.observation_shapes.items()}
    batch["action"] = torch.randn(BATCH, steps, source.policy.action_width)
    batch["action_is_pad"] = torch.zeros(BATCH, steps, dtype=torch.bool)
    optimizer = config.get_optimizer_preset().build(policy.parameters())

    def update() -> None:
        policy.train()
        policy.forward(batch)[0].backward()
        optimizer.step()
        optimizer.zero_grad()

    return update


def _milliseconds(call: Any, times: int) -> float:
    for _ in range(3):
        call()
    began = time.process_time()
    for _ in range(times):
        call()
    return (time.process_time() - began) / times * 1e3


def word(valid: float, share: float) -> str:
    """What the criteria of results/multimodality/README.md call a policy."""
    from dualhead_eval.effects.sites import MIN_VALID_RATE, ORIGIN_CAPACITY

    if valid < MIN_VALID_RATE:
        return "low validity"
    return "keeps both" if share >= 0.5 else "keeps one" if not share >= ORIGIN_CAPACITY else "in between"


def table(task: Task, results: Path) -> str:
    """The table in Markdown, from a folder of results alone."""
    from dualhead_eval.evaluation.rollouts import read_closed_loop
    from dualhead_eval.gate.file import read_gate
    from dualhead_eval.statistics.run_summary import summarise_run
    from dualhead_eval.statistics.training_record import training_record

    head = ["policy", "parameters", "steps", "loss", "valid [95 %]", "C / max C [95 %]", "TV to data"]
    head += ["success, position", "success, joint", "CPU ms: step", "decision", "it"]
    rows = [head, ["---"] * len(head)]
    for entry in task.entries:
        file = results / f"{entry.name}.gate.json.gz"
        if not file.exists():
            continue
        gate = read_gate(file)
        run, record = summarise_run(gate), training_record(gate)
        largest = 1 - 1 / run.n_modes
        capacity = run.intervals["capacity"]
        share = run.capacity / largest if run.n_both_valid else float("nan")
        bounds = f"{share:.2f} [{capacity.low / largest:.2f}, {capacity.high / largest:.2f}]"
        valid = run.intervals["valid_rate"]
        loops = []
        for control in ("position", "joint"):
            outcomes = results / f"{entry.name}-{control}.rollouts.json"
            if not outcomes.exists():
                loops.append("not run")
                continue
            loop = read_closed_loop(outcomes)[1]
            low, high = loop.success_interval.low, loop.success_interval.high
            loops.append(f"{loop.successes} of {loop.episodes} [{low:.0%}, {high:.0%}]")
        costs = json.loads((results / f"{entry.name}.costs.json").read_text())
        rows.append(
            [
                entry.title, f"{costs['parameters'] / 1e6:.2f} M", f"{record.steps:,}", record.loss,
                f"{run.valid_rate:.3f} [{valid.low:.3f}, {valid.high:.3f}]",
                bounds if share == share else "undefined",
                f"{run.tv_target_q:.3f}" if share == share else "undefined", *loops,
                f"{costs['training_step_ms']:.0f}", f"{costs['decision_ms']:.0f}", word(run.valid_rate, share),
            ]
        )  # fmt: skip
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def figure(task: Task, data: Path, budget: Budget, condition: int, picture: Path) -> None:
    """Draws of every policy under one test condition, beside the demonstrations."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    from dualhead_envs.dataset_frames import read_split
    from dualhead_eval.evaluation.conditions import open_conditions
    from dualhead_eval.evaluation.draws import open_paths

    bank = open_conditions(data / "test")
    one, frames = bank[slice(condition, condition + 1)], read_split(data / "test")
    windows = frames.mode_windows(bank.horizon)
    assert windows is not None
    shown: list[tuple[str, np.ndarray]] = [("demonstrations", windows[condition])]
    for entry in task.entries:
        if (budget.results / f"{entry.name}.gate.json.gz").exists():
            source = open_paths(budget.checkpoint(entry), "position")
            title = f"{entry.title}\n{budget.steps_of(entry):,} steps"
            shown.append((title, source.paths(one, 48, source.default_nfe, SEED)[0]))
    page = Figure(figsize=(2.3 * len(shown), 2.4), layout="constrained")
    axes = page.subplots(1, len(shown), sharex=True, sharey=True)
    names = [name.rpartition(".")[0] for name in ("obstacle.center.x", "obstacle.half_size.x")]
    state = dict(zip(frames.info["features"]["observation.environment_state"]["names"], one.state[0], strict=True))
    right, up = task.axes
    center, half = (np.array([float(state[f"{name}.{axis}"]) for axis in "xyz"]) for name in names)
    colours = np.array(["#999999", "#0072b2", "#d55e00"])
    for axis, (title, paths) in zip(axes, shown, strict=True):
        label = bank.partition.score(paths, one.state)[0]
        strength = bank.partition.score(paths, one.state)[1]
        label = np.where(strength >= bank.partition.tau, label, -1)
        corner = center - half
        axis.add_patch(Rectangle((corner[right], corner[up]), 2 * half[right], 2 * half[up], color="#444444"))
        for path, mode in zip(paths, label, strict=True):
            axis.plot(path[:, right], path[:, up], color=colours[mode + 1], linewidth=0.8, alpha=0.7)
        axis.set_title(f"{title}\nvalid {(label >= 0).mean():.0%}", fontsize=8)
        axis.set_aspect("equal")
        axis.tick_params(labelsize=7)
        axis.set_xlabel(task.labels[0], fontsize=8)
    axes[0].set_ylabel(task.labels[1], fontsize=8)
    page.suptitle(
        f"16 predicted steps from one branch point, {task.view}; blue and orange: the two modes, grey: neither",
        fontsize=9,
    )
    page.savefig(picture, dpi=150)
    print(picture)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stage", choices=["train", "evaluate", "table", "figure"])
    parser.add_argument("--env", choices=list(TASKS), default="v2", help="the environment (default: v2)")
    parser.add_argument("--data", type=Path, help="recorded by `dualhead record` (default: data/ENV)")
    parser.add_argument("--runs", type=Path, help="folder of the policies (default: outputs/multimodality/ENV)")
    parser.add_argument(
        "--only", nargs="+", choices=[entry.name for entry in TASKS["v2"].entries], help="some policies"
    )
    parser.add_argument("--condition", type=int, default=0, help="of the figure (default: the first)")
    parser.add_argument("--smoke", action="store_true", help="20 steps, 8 pairs and 2 episodes, results in RUNS")
    args = parser.parse_args()
    task = TASKS[args.env]
    data, runs = args.data or Path("data", task.name), args.runs or Path("outputs", "multimodality", task.name)
    budget, picture = Budget(runs, RESULTS / task.name), IMAGES / task.picture
    if args.smoke:
        budget, picture = Budget(runs, runs / "results", pairs=8, episodes=2, steps=20), runs / task.picture
    if args.stage == "table":
        print(table(task, budget.results))
    elif args.stage == "figure":
        figure(task, data, budget, args.condition, picture)
    else:
        for entry in task.entries:
            if args.only is None or entry.name in args.only:
                (train if args.stage == "train" else evaluate)(entry, data, budget)


if __name__ == "__main__":
    main()
