"""Inputs of coming steps, drawn by other processes while an accelerator trains.

A step's draws are made on the CPU so that a run draws the same everywhere, but an accelerator trains more run-steps
per second than one core draws. Each process draws for some of the runs, a block of steps at a time, into shared memory.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing.shared_memory import SharedMemory

import torch
from torch import Tensor

from dualhead_envs.worker_processes import end_with, interrupts_kept_from_workers
from dualhead_policy.training.stacked.run_feed import RunFeed

#: Bytes of a block of steps at most.
BLOCK_BYTES = 128 * 2**20
#: Blocks that are drawn ahead.
BLOCKS = 3


@dataclass(frozen=True)
class BlockLayout:
    """Where the inputs of a block of steps lie in one stretch of memory.

    Attributes:
        steps: Steps S of a block.
        shapes: Shape (S, N, B, ...) of every input by name.
        dtypes: Type of every input by name.
    """

    steps: int
    shapes: dict[str, tuple[int, ...]]
    dtypes: dict[str, torch.dtype]

    @classmethod
    def of(cls, feeds: Sequence[RunFeed]) -> BlockLayout:
        """The layout for N runs; the first batch of an epoch is the largest."""
        example = feeds[0].inputs(0)
        bytes_per_step = len(feeds) * sum(value.nbytes for value in example.values())
        steps = max(1, BLOCK_BYTES // bytes_per_step)
        shapes = {name: (steps, len(feeds), *value.shape) for name, value in example.items()}
        return cls(steps, shapes, {name: value.dtype for name, value in example.items()})

    @property
    def nbytes(self) -> int:
        """Bytes of a block."""
        return sum(self._nbytes(name) for name in self.shapes)

    def views(self, memory: SharedMemory) -> dict[str, Tensor]:
        """The inputs in a stretch of memory."""
        found, offset = {}, 0
        for name, shape in self.shapes.items():
            count = math.prod(shape)
            flat = torch.frombuffer(memory.buf, dtype=self.dtypes[name], count=count, offset=offset)
            found[name] = flat.view(shape)
            offset += self._nbytes(name)
        return found

    def _nbytes(self, name: str) -> int:
        return math.prod(self.shapes[name]) * self.dtypes[name].itemsize


class DrawAhead:
    """Processes that draw the inputs of coming steps, block after block.

    Args:
        feeds: The runs.
        first_step: Step from which they go on.
        last_step: Step at which they end; no block reaches beyond.
        processes: Processes; None: one per core but one.
    """

    def __init__(self, feeds: Sequence[RunFeed], first_step: int, last_step: int, processes: int | None = None):
        count = min(processes or max(1, (os.cpu_count() or 2) - 1), len(feeds))
        self.layout = BlockLayout.of(feeds)
        self._next, self._last = first_step, last_step
        self._memory = [SharedMemory(create=True, size=self.layout.nbytes) for _ in range(BLOCKS)]
        self._views = [self.layout.views(memory) for memory in self._memory]
        names = [memory.name for memory in self._memory]
        # What the workers import, one process imports once; they are its copies.
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([__name__])
        self._workers = []
        shares = [list(range(worker, len(feeds), count)) for worker in range(count)]
        with interrupts_kept_from_workers():
            for share in shares:
                own = {run: feeds[run] for run in share}
                self._workers.append(ProcessPoolExecutor(1, context, _begin, (names, self.layout, own)))
            self._pending: list[list[Future[None]]] = [self._ask(block) for block in range(BLOCKS)]

    def _ask(self, block: int) -> list[Future[None]]:
        first, count = self._next, min(self.layout.steps, self._last - self._next)
        self._next += max(count, 0)
        return [worker.submit(_fill, block, first, count) for worker in self._workers] if count > 0 else []

    def block(self, number: int) -> dict[str, Tensor]:
        """The inputs (S, N, B, ...) of block ``number``, counted from 0, once they are drawn."""
        for future in self._pending[number % BLOCKS]:
            future.result()
        return self._views[number % BLOCKS]

    def release(self, number: int) -> None:
        """Say that block ``number`` has been copied, so that its memory can take a later one."""
        self._pending[number % BLOCKS] = self._ask(number % BLOCKS)

    def close(self) -> None:
        """End the processes and give their memory back."""
        for worker in self._workers:
            worker.shutdown(cancel_futures=True)
        self._views = []
        for memory in self._memory:
            # A tensor that somebody still holds keeps its pages until it goes.
            with contextlib.suppress(BufferError):
                memory.close()
            memory.unlink()


class _Worker:
    """What a process of :class:`DrawAhead` holds."""

    memory: Sequence[SharedMemory]
    views: Sequence[Mapping[str, Tensor]]
    feeds: Mapping[int, RunFeed]


def _begin(names: Sequence[str], layout: BlockLayout, feeds: Mapping[int, RunFeed]) -> None:
    # The parent is the process that is copied, which ends with the one that started it.
    end_with(os.getppid())
    torch.set_num_threads(1)
    _Worker.memory = [SharedMemory(name) for name in names]
    _Worker.views = [layout.views(memory) for memory in _Worker.memory]
    _Worker.feeds = feeds


def _fill(block: int, first_step: int, count: int) -> None:
    view = _Worker.views[block]
    for run, feed in _Worker.feeds.items():
        for offset in range(count):
            for name, value in feed.inputs(first_step + offset).items():
                view[name][offset, run, : len(value)] = value
