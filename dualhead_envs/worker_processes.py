"""Worker processes that end with the process that started them, however that ends."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

#: Seconds between two looks at the parent.
_LOOK_SECONDS = 0.5


@contextmanager
def interrupts_kept_from_workers() -> Iterator[None]:
    """Let processes that are started meanwhile ignore Ctrl-C, which a terminal sends to all: their parent ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def workers_ended_afterwards() -> Iterator[None]:
    """End the worker processes of ``joblib.Parallel`` when the block is left, and what they still do with them.

    Left alone they wait five minutes for more work: they hold their memory, and keep a process that
    ``multiprocessing`` started from ending.
    """
    from joblib.externals.loky import get_reusable_executor

    try:
        yield
    finally:
        get_reusable_executor(reuse=True).shutdown(wait=True, kill_workers=True)


def end_with(parent: int) -> None:
    """Let this process end soon after ``parent``, the process that started it and may be killed without a word."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
