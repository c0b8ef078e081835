"""``dualhead`` commands in processes of their own, to be ended at any moment.

They are forked from a server that has imported everything once, so that a hundred of them cost their work alone.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import time
from pathlib import Path

#: Imported by the server before it forks.
PRELOADED = [
    "dualhead_eval.commands.evaluate",
    "dualhead_eval.commands.report",
    "dualhead_eval.evaluation.closed_loop",
    "dualhead_eval.report.page",
    "dualhead_eval.report.figures.figures",
    "dualhead_eval.commands.study",
    "dualhead_eval.studies.study",
    "dualhead_eval.studies.study_figure",
    "dualhead_eval.studies.study_verdict",
    "dualhead_eval.studies.study_work",
    "dualhead_policy.training.run",
    "dualhead_policy.training.sweep.run_sweep",
    "dualhead_policy.pretrained",
    "dualhead_envs.record_command",
    "dualhead_envs.ring.record",
    "dualhead_envs.recording.assembly",
]
#: Seconds within which the workers of a command must end after it.
GRACE_SECONDS = 20.0


class Command:
    """A running command, leader of a process group of its own as one that was typed in a terminal.

    Args:
        arguments: What follows ``dualhead`` on the command line.
        log: File that gets its standard output and error.
    """

    def __init__(self, arguments: list[str], log: Path):
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(PRELOADED)
        self.log = log
        started, child_end = context.Pipe(duplex=False)
        self.process = context.Process(target=_run, args=(arguments, str(log), child_end))
        self.process.start()
        child_end.close()
        self.group = started.recv()

    def wait(self, seconds: float | None = None) -> int | None:
        """The exit status, negative for a signal; None if the command still runs after ``seconds``."""
        self.process.join(seconds)
        return self.process.exitcode

    def send(self, number: signal.Signals) -> bool:
        """Send a signal as a user or a system would; returns whether the command was still running."""
        if self.process.exitcode is not None:
            return False
        if number == signal.SIGINT:
            os.killpg(self.group, number)  # a terminal's Ctrl-C reaches the workers too
        else:
            os.kill(self.group, number)
        return True

    def orphans(self) -> list[str]:
        """Command lines of what is left of its group after the time of grace."""
        deadline = time.monotonic() + GRACE_SECONDS
        while (left := _members(self.group)) and time.monotonic() < deadline:
            time.sleep(0.02)
        for pid in left:
            os.kill(pid, signal.SIGKILL)
        return list(left.values())


def digests(*products: Path) -> dict[str, str] | None:
    """SHA-256 of every file of some products, files or folders; None if none of them is there."""
    files = [
        (path.relative_to(product.parent), path)
        for product in products
        for path in ([product] if product.is_file() else sorted(product.rglob("*")))
        if path.is_file()
    ]
    return {str(name): hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files} or None


def _run(arguments: list[str], log: str, started: multiprocessing.connection.Connection) -> None:
    import torch

    from dualhead_eval.cli import main

    os.setpgid(0, 0)
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(descriptor, stream)
    torch.set_num_threads(1)
    started.send(os.getpid())
    started.close()
    sys.exit(main(arguments))


def _members(group: int) -> dict[int, str]:
    """Living processes of a group: their command lines by number."""
    found = {}
    for path in Path("/proc").iterdir():
        if not path.name.isdigit():
            continue
        try:
            state, _, its_group = (path / "stat").read_text().rpartition(")")[2].split()[:3]
            if int(its_group) == group and state != "Z":
                found[int(path.name)] = (path / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except (OSError, ValueError):
            continue  # ended meanwhile
    return found
