"""Train one group of a sweep: in a process of its own, on whichever machine."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from dualhead_policy.training.checkpoints import last_step
from dualhead_policy.training.sweep.sweep_file import SweepRun

if TYPE_CHECKING:
    from dualhead_policy.training.stacked.field_kernel import Precision

#: Seconds between two reports of a group.
REPORT_SECONDS = 0.5
#: Seconds for which a run's folder may still be held by a process that is about to end.
CLAIM_SECONDS = 10.0
#: Steps between two looks at the losses: they stay on the device in between.
LOOK_EVERY = 50


@dataclass(frozen=True)
class Group:
    """Runs that train as one program.

    Attributes:
        name: Its name in the manifest.
        output: The sweep's folder.
        runs: The runs.
        precision: ``"fp32"``, ``"tf32"`` or ``"bf16"``: type in which the velocity fields compute.
        threads: Arithmetic threads, or None for torch's own choice.
    """

    name: str
    output: Path
    runs: tuple[SweepRun, ...]
    precision: str
    threads: int | None

    @property
    def progress_file(self) -> Path:
        """Where the group says how far it is."""
        return self.output / ".groups" / f"{self.name}.progress.json"

    @property
    def commit_file(self) -> Path:
        """What makes a checkpoint of the whole group one."""
        return self.output / ".groups" / f"{self.name}.commit.json"


def train_group(group: Group) -> dict[str, dict[str, Any]]:
    """Train a group to its end, from its runs' last checkpoints.

    Returns:
        ``state``, ``step`` and ``error`` of every run, by name.
    """
    import torch

    from dualhead_policy.quiet import quiet_libraries
    from dualhead_policy.training.stacked.freed_memory import keep_freed_memory
    from dualhead_policy.training.sweep.group_commit import publish_group

    quiet_libraries()
    keep_freed_memory()
    if group.threads is not None:
        torch.set_num_threads(group.threads)
    outcome: dict[str, dict[str, Any]] = {}
    with contextlib.redirect_stdout(None):
        publish_group(group.output, group.commit_file)
        _train_members(group, group.runs, outcome)
    return outcome


def _train_members(group: Group, runs: Sequence[SweepRun], outcome: dict[str, dict[str, Any]]) -> None:
    """Train some of a group's runs, in halves where they do not fit into memory together."""
    import gc
    import sys

    import torch

    try:
        with contextlib.ExitStack() as stack:
            trainings = dict(_built(group, runs, outcome, stack))
            by_step: dict[int, dict[str, Any]] = {}
            for name, training in trainings.items():
                by_step.setdefault(training.step, {})[name] = training
            # Runs of one group are at one step, unless somebody has continued or deleted one of them.
            for together in by_step.values():
                _save_together(together.values())
                failed = _train_together(group, together)
                for name in together:
                    sentence = failed.get(name)
                    ended = {"state": "failed", "error": sentence} if sentence else {"state": "finished"}
                    outcome[name] = ended | {"step": last_step(group.output / name)}
        return
    except (torch.OutOfMemoryError, MemoryError, RuntimeError) as error:
        if not isinstance(error, torch.OutOfMemoryError | MemoryError) and "allocate memory" not in str(error):
            raise
    except OSError as error:
        for run in runs:
            outcome.setdefault(
                run.name, {"state": "failed", "error": str(error), "step": last_step(group.output / run.name)}
            )
        return
    left = [run for run in runs if run.name not in outcome]
    gc.collect()
    if torch.cuda.is_available():
        torch.cuda.empty_cache()
    if len(left) == 1:
        sentence = "it does not fit into memory alone: lower its batch_size or width, or free memory"
        outcome[left[0].name] = {"state": "failed", "error": sentence}
        return
    half = (len(left) + 1) // 2
    print(
        f"dualhead: {group.name}: {len(left)} runs do not fit into memory together, training {half} and then "
        f"{len(left) - half} from their last checkpoints",
        file=sys.stderr,
        flush=True,
    )
    _train_members(group, left[:half], outcome)
    _train_members(group, left[half:], outcome)


def _save_together(trainings: Collection[Any]) -> None:
    """Let every run of a group save where any of them wants to: a group is at one step as a whole."""
    points = frozenset().union(*(training.save_at for training in trainings))
    for training in trainings:
        training.save_at = points


def _built(
    group: Group, runs: Sequence[SweepRun], outcome: dict[str, dict[str, Any]], stack: contextlib.ExitStack
) -> Iterator[tuple[str, Any]]:
    """The trainings that can go on; what cannot is written into ``outcome``."""
    from dualhead_policy.training.array_store import ArrayStore
    from dualhead_policy.training.trainer import Training

    store = ArrayStore(group.output / ".windows")
    parsed: dict[tuple[Any, ...], Any] = {}
    for run in runs:
        folder = group.output / run.name
        try:
            stack.enter_context(_claimed_soon(folder))
            cfg = _configuration(run, folder, parsed)
            training = Training(cfg, fresh_paths=run.fresh_paths and not cfg.resume)
        except (ValueError, OSError) as error:
            outcome[run.name] = {"state": "failed", "error": str(error)}
            continue
        if training.step >= cfg.steps:
            outcome[run.name] = {"state": "finished", "step": training.step}
            continue
        training.save_at = frozenset(run.save_at)
        training.share_windows(store)
        yield run.name, training


def _configuration(run: SweepRun, folder: Path, parsed: dict[tuple[Any, ...], Any]) -> Any:
    """The configuration of a run, begun or new; new ones that differ in their seed alone are parsed once.

    Args:
        run: The run.
        folder: Its folder.
        parsed: Configurations parsed so far, by arguments but for the seed; grows.
    """
    import copy

    from dualhead_policy.training.arguments import parse_training_config
    from dualhead_policy.training.checkpoints import last_checkpoint
    from dualhead_policy.training.run_folder import refuse_occupied

    if last_checkpoint(folder) is not None:
        return parse_training_config(["--resume=true", f"--output_dir={folder}"], None)
    seedless = tuple(argument for argument in run.arguments if not argument.startswith("--seed="))
    if (seedless, run.preset) not in parsed:
        parsed[seedless, run.preset] = parse_training_config([*run.arguments, f"--output_dir={folder}"], run.preset)
    refuse_occupied(folder)
    cfg = copy.deepcopy(parsed[seedless, run.preset])
    cfg.seed, cfg.output_dir = run.seed, folder
    return cfg


@contextlib.contextmanager
def _claimed_soon(folder: Path) -> Iterator[None]:
    """A run's folder for this process alone; the workers of a command that was killed need a moment to end."""
    from dualhead_policy.training.run import claimed_run

    until = time.monotonic() + CLAIM_SECONDS
    with contextlib.ExitStack() as stack:
        while True:
            try:
                stack.enter_context(claimed_run(folder))
                break
            except BlockingIOError:
                if time.monotonic() > until:
                    raise
                time.sleep(0.1)
        yield


def _train_together(group: Group, trainings: dict[str, Any]) -> dict[str, str]:
    """Train runs as one program; returns the sentence of every run that failed, by name."""

    from dualhead_policy.training.stacked.stacked_training import StackedTraining

    logs = {name: training.begin() for name, training in trainings.items()}
    failed: dict[str, str] = {}
    running = dict(trainings)
    report = _reporter(group)
    while running:
        stack = StackedTraining(list(running.values()), precision=cast("Precision", group.precision))
        with contextlib.closing(stack):
            wrong = _train_on(stack, running, logs, group, report)
        if not wrong:
            break
        for name, step in wrong.items():
            rate = running.pop(name).policy.config.optimizer_lr
            failed[name] = (
                f"the loss is not a number at step {step}: lower policy.optimizer_lr (now {rate}) and start again"
            )
    return failed


def _train_on(
    stack: Any, running: dict[str, Any], logs: dict[str, Any], group: Group, report: Callable[..., None]
) -> dict[str, int]:
    """Train a stack to its end, or until losses are no numbers; returns the runs whose are not, and when."""
    from dualhead_policy.modeling_dualhead import MEASURE_EVERY
    from dualhead_policy.training.sweep.group_commit import save_group

    cfg = stack.trainings[0].cfg
    while stack.step < cfg.steps:
        if stack.step % MEASURE_EVERY == 0:
            for name, training in running.items():
                batch = training.source.batch(stack.step)
                logs[name].measure(training.policy.measure(batch.observation, batch.action, batch.token))
        stops = [every - stack.step % every for every in (MEASURE_EVERY, LOOK_EVERY, cfg.save_freq)]
        stops += [at - stack.step for at in stack.trainings[0].save_at if at > stack.step]
        losses = stack.updates(min(*stops, cfg.steps - stack.step))
        wrong = _log(logs, list(running), losses, stack.step)
        if wrong:
            return wrong
        report(stack.step, cfg.steps, list(running), logs)
        if stack.trainings[0].saves_now():
            for name in running:
                logs[name].flush(stack.step)
            save_group(stack, group.output, group.commit_file)
            report(stack.step, cfg.steps, list(running), logs, saved=stack.step)
    return {}


def _log(logs: dict[str, Any], names: Sequence[str], losses: Any, step: int) -> dict[str, int]:
    """Write the losses of the last steps into the runs' logs; returns the runs whose loss is not a number, and when."""
    wrong: dict[str, int] = {}
    first = step - len(losses) + 1
    for offset, (loss, flow) in enumerate(losses.tolist()):
        for name, own_loss, own_flow in zip(names, loss, flow, strict=True):
            if own_loss != own_loss:
                wrong.setdefault(name, first + offset)
            else:
                logs[name].add(first + offset, own_loss, own_flow)
    return wrong


def _reporter(group: Group) -> Callable[..., None]:
    last, last_saved = 0.0, 0
    group.progress_file.parent.mkdir(parents=True, exist_ok=True)

    def report(step: int, steps: int, names: Sequence[str], logs: Any, saved: int | None = None) -> None:
        nonlocal last, last_saved
        now = time.monotonic()
        if saved is None and now - last < REPORT_SECONDS:
            return
        last, last_saved = now, saved if saved is not None else last_saved
        temporary = group.progress_file.with_suffix(".partial")
        temporary.write_text(json.dumps({"step": step, "steps": steps, "runs": list(names), "saved": last_saved}))
        temporary.replace(group.progress_file)

    return report
