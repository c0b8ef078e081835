"""One training run, from its flags to its final checkpoint, alone in its folder."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from lerobot.configs import parser

from dualhead_envs.recording.claim import claimed, discard
from dualhead_policy.training.arguments import parse_training_config
from dualhead_policy.training.trainer import Progress, Training


def train_run(
    arguments: Sequence[str],
    preset: str | None = None,
    *,
    fresh_paths: bool = False,
    follow: Callable[[Training], contextlib.AbstractContextManager[Progress]] | None = None,
) -> Path:
    """Train as the flags of ``dualhead train`` say.

    Args:
        arguments: Flags in LeRobot's spelling.
        preset: Name of a preset whose values the flags override, or None.
        fresh_paths: Draw new ring paths at every step instead of visiting the recorded windows.
        follow: Given the training that is about to begin, a context in which its progress is shown.

    Returns:
        The final checkpoint's ``pretrained_model`` folder.

    Raises:
        BlockingIOError: If another process trains into the folder.
        Exception: As :func:`parse_training_config` and :class:`Training` do.
    """
    output = parse_training_config(arguments, preset).output_dir
    assert output is not None
    with claimed_run(output):
        # Read again: before the claim, another process may have gone on or begun in the folder.
        others = parser.filter_arg("output_dir", list(arguments))
        cfg = parse_training_config([f"--output_dir={output}", *others], preset)
        training = Training(cfg, fresh_paths=fresh_paths)
        with follow(training) if follow is not None else contextlib.nullcontext() as progress:
            return training.run(progress)


@contextlib.contextmanager
def claimed_run(output_dir: Path) -> Iterator[None]:
    """Hold a run's folder, which need not exist, for this process alone; the claim is a hidden sibling.

    Raises:
        BlockingIOError: If another process trains into it.
    """
    output = output_dir.resolve()
    with claimed(output.with_name(f".{output.name}.training"), output_dir) as claim:
        try:
            yield
        finally:
            discard(claim)
