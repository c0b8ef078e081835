"""From command-line flags to a validated LeRobot training configuration."""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import draccus
from lerobot.configs import parser
from lerobot.configs.train import TRAIN_CONFIG_NAME, TrainPipelineConfig
from lerobot.utils.constants import PRETRAINED_MODEL_DIR

from dualhead_policy.training.checkpoints import last_checkpoint
from dualhead_policy.training.config_file import check_config_file
from dualhead_policy.training.presets import PRESETS
from dualhead_policy.training.run_folder import refuse_occupied

#: Longest part of a library's complaint that is shown, in characters.
LONGEST_REASON = 300


def parse_training_config(arguments: Sequence[str], preset: str | None) -> TrainPipelineConfig:
    """Parse the flags of ``lerobot-train`` as ``dualhead train`` completes them.

    ``--policy.type=dualhead`` and ``--dataset.repo_id`` may be left out; ``--resume=true --output_dir=RUN``
    finds the newest checkpoint of RUN, and begins a run that has none yet.

    Args:
        arguments: Flags in LeRobot's spelling.
        preset: Name of a preset whose values the flags override, or None.

    Raises:
        ValueError: If a flag or value is unknown, in one sentence.
        FileExistsError: If the output folder already holds a run, or other files.
        FileNotFoundError: If there is no dataset, or nothing to resume from.
    """
    given = list(arguments)
    resume = (parser.parse_arg("resume", given) or "false").lower() in ("true", "1", "yes")
    complete: list[str] = []
    config_file = parser.parse_arg("config_path", given)
    if config_file:
        check_config_file(Path(config_file))
    kind = parser.get_type_arg("policy", given)
    if kind not in (None, "dualhead"):
        raise ValueError(f"--policy.type={kind} is not 'dualhead': use lerobot-train for other policies")
    path = parser.get_path_arg("policy", given)
    if path and "/" not in path and not Path(path).exists():
        raise FileNotFoundError(
            f"--policy.path={path} does not exist, expected a policy's folder or USER/NAME on a hub: give one of these"
        )
    if resume and not config_file:
        checkpoint = _checkpoint_config(given)
        if checkpoint is None:
            # Interrupted before its first checkpoint: the run starts again.
            resume, given = False, parser.filter_arg("resume", given)
        else:
            check_config_file(checkpoint)
            complete = [f"--config_path={checkpoint}"]
    if not resume:
        root = parser.parse_arg("dataset.root", given)
        if root is None:
            raise ValueError(
                "--dataset.root is missing: give the training split, for example --dataset.root=data/ring/train"
            )
        complete = ["--env_eval_freq=0"]
        # A configuration file brings its own budget; a preset that is asked for overrides it.
        budget = preset or (None if config_file else "smoke")
        if budget is not None:
            complete += [f"--{name}={value}" for name, value in PRESETS[budget].items()]
        if not parser.parse_arg("dataset.repo_id", given):
            complete.append(f"--dataset.repo_id=local/{Path(root).resolve().parent.name}")
        if not (parser.get_path_arg("policy", given) or parser.get_type_arg("policy", given)):
            complete.insert(0, "--policy.type=dualhead")
    with _command_line([*complete, *given]):
        cfg = _parse()
        _validate(cfg)
    return cfg


def _checkpoint_config(given: Sequence[str]) -> Path | None:
    """Configuration of the newest checkpoint to resume from; None if the flags can begin the run that has none."""
    output_dir = parser.parse_arg("output_dir", given)
    if output_dir is None:
        raise ValueError("--resume=true needs the run to resume: give its --output_dir")
    checkpoint = last_checkpoint(output_dir)
    if checkpoint is not None:
        return checkpoint / PRETRAINED_MODEL_DIR / TRAIN_CONFIG_NAME
    if parser.parse_arg("dataset.root", given):
        return None
    raise FileNotFoundError(
        f"{output_dir} holds no complete checkpoint to resume from: repeat the command that began the run, which "
        "starts again"
    )


def _validate(cfg: TrainPipelineConfig) -> None:
    """LeRobot's validation, but for its refusal of every folder that exists."""
    output = cfg.output_dir
    if output is None or cfg.resume:
        cfg.validate()
        return
    refuse_occupied(Path(output))
    cfg.output_dir = None
    cfg.validate()
    cfg.output_dir = output


@contextlib.contextmanager
def _command_line(arguments: list[str]) -> Iterator[None]:
    """LeRobot reads parts of its configuration from ``sys.argv`` again while validating."""
    saved = sys.argv
    sys.argv = ["dualhead train", *arguments]
    try:
        yield
    finally:
        sys.argv = saved


def _parse() -> TrainPipelineConfig:
    def configured(cfg: TrainPipelineConfig) -> TrainPipelineConfig:
        return cfg

    # LeRobot reads the class from the annotation, which is a string in this module.
    configured.__annotations__["cfg"] = TrainPipelineConfig
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return parser.wrap()(configured)()
    except (SystemExit, argparse.ArgumentError, draccus.utils.DecodingError) as error:
        own = _sentence_of_ours(error)
        if own is not None:
            raise ValueError(own) from error
        text = complaint.getvalue().strip() or str(error)
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        # draccus names the field first, and what went wrong with it in a line of its own.
        named = [line for line in lines if line.startswith("Underlying error")] and lines[:1]
        reason = " ".join([*named, lines[-1]]).removeprefix("dualhead train: error: ")[:LONGEST_REASON]
        raise ValueError(
            f"{_flag_of(reason)}{reason}: `dualhead train` takes the flags of lerobot-train, and every field of "
            "DualheadConfig as --policy.FIELD=VALUE"
        ) from error


def _flag_of(reason: str) -> str:
    """The flag whose value a reason quotes, where draccus names the value alone; empty if there is none."""
    quoted = re.findall(r"(?<!\w)'([^']+)'", reason)
    flags = [flag for flag in sys.argv[1:] if any(word in flag.partition("=")[2] for word in quoted)]
    return f"{flags[0][:LONGEST_REASON]}: " if flags and flags[0].partition("=")[0] not in reason else ""


def _sentence_of_ours(error: BaseException) -> str | None:
    """What DualheadConfig says, which draccus wraps in errors of its own."""
    seen: set[int] = set()
    cause: BaseException | None = error
    while cause is not None and id(cause) not in seen:
        if isinstance(cause, ValueError) and str(cause).startswith("policy."):
            return str(cause)
        seen.add(id(cause))
        cause = cause.__cause__ or cause.__context__
    return None
