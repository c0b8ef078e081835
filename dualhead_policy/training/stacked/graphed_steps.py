"""Steps of N stacked runs on CUDA: one recorded graph per size of batch, replayed without Python between its kernels.

On a CPU, which records nothing, the same steps are made one by one: for tests.

A step of these models is a few hundred small kernels; launched one by one from Python they leave a large accelerator
idle nine tenths of the time. The graph reads its inputs from a ring of blocks in the device's memory, which
:mod:`.draw_ahead` fills and a copy engine moves while earlier steps train, and writes losses into another. Nothing
waits for the host inside a block.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from dualhead_policy.training.recorded_windows import RecordedWindows
from dualhead_policy.training.stacked.device_windows import DeviceWindows
from dualhead_policy.training.stacked.draw_ahead import DrawAhead
from dualhead_policy.training.stacked.run_feed import RunFeed
from dualhead_policy.training.stacked.stacked_adam import StackedAdam
from dualhead_policy.training.stacked.stacked_model import StackedModel
from dualhead_policy.training.trainer import Training

#: Forward and backward passes before a graph is recorded: libraries choose their kernels in them.
WARM_UPS = 3
#: Halves of the ring of blocks: one trains while the other is filled.
HALVES = 2
RATE = "rate"


class GraphedSteps:
    """Recorded optimiser steps of N runs.

    Args:
        trainings: The runs, at one step.
        model: Their stacked model.
        optimizer: Their stacked optimiser.
        processes: Processes that draw ahead; None: one per core but one.
    """

    def __init__(
        self,
        trainings: Sequence[Training],
        model: StackedModel,
        optimizer: StackedAdam,
        processes: int | None = None,
    ):
        self._model, self._optimizer, self._trainings = model, optimizer, trainings
        self._parameters = list(model.parameters.values())
        self._feeds = [RunFeed.of(training) for training in trainings]
        recorded = [training.source for training in trainings if isinstance(training.source, RecordedWindows)]
        self._windows = DeviceWindows(recorded) if recorded else None
        self._first, self._last = trainings[0].step, trainings[0].cfg.steps
        self._ahead = DrawAhead(self._feeds, self._first, self._last, processes)
        self._block = self._ahead.layout.steps
        device = self._parameters[0].device
        shapes = {name: shape[1:] for name, shape in self._ahead.layout.shapes.items()} | {RATE: (len(trainings),)}
        dtypes = self._ahead.layout.dtypes | {RATE: torch.float32}
        self._ring = {
            name: torch.zeros(HALVES * self._block, *shape, dtype=dtypes[name], device=device)
            for name, shape in shapes.items()
        }
        pinned = device.type == "cuda"
        self._staging = [
            {
                name: torch.zeros(self._block, *shape, dtype=dtypes[name], pin_memory=pinned)
                for name, shape in shapes.items()
            }
            for _ in range(HALVES)
        ]
        self._schedules = [_schedule(training) for training in trainings]
        self._losses = torch.zeros(HALVES * self._block, 2, len(trainings), device=device)
        self._place = torch.zeros(1, dtype=torch.int64, device=device)
        self._backend: Any = torch.cuda if device.type == "cuda" else torch.cpu
        self._copies = self._backend.Stream()
        self._copied = [self._backend.Event() for _ in range(HALVES)]
        self._trained = [self._backend.Event() for _ in range(HALVES)]
        self._loaded = 0
        self._graphs: dict[int, Any] = {}
        for size in sorted({self._feeds[0].size(step) for step in range(self._first, self._last)}, reverse=True):
            compute = partial(self._gradients, size)
            if device.type == "cuda":
                pool = next(iter(self._graphs.values())).pool() if self._graphs else None
                self._graphs[size] = _recorded(compute, self._step, pool)
            else:
                self._graphs[size] = _Unrecorded(compute, self._step)

    def run(self, count: int) -> Tensor:
        """Make ``count`` steps from the runs' current one; returns losses and flow losses (count, 2, N).

        The runs' own step counts are the caller's to advance.
        """
        start = self._trainings[0].step - self._first
        losses: list[Tensor] = []
        unread = start
        for offset in range(start, start + count):
            block, within = divmod(offset, self._block)
            if within == 0:
                self._load(block)
                self._load(block + 1)
                self._backend.current_stream().wait_event(self._copied[block % HALVES])
            self._graphs[self._feeds[0].size(self._first + offset)].replay()
            ended = within == self._block - 1
            if ended:
                self._trained[block % HALVES].record()
            if ended or offset == start + count - 1:
                place = unread % len(self._losses)
                losses.append(self._losses[place : place + offset + 1 - unread].clone())
                unread = offset + 1
        return torch.cat(losses)

    def close(self) -> None:
        """End the processes that draw."""
        self._backend.synchronize()
        self._ahead.close()

    def _load(self, block: int) -> None:
        """Bring a block to the device, if it is not there, beside the steps of the one before."""
        first = self._first + block * self._block
        if block < self._loaded or first >= self._last:
            return
        half = block % HALVES
        staging = self._staging[half]
        # The copy before from this staging memory has ended once its event has.
        self._copied[half].synchronize()
        for name, value in self._ahead.block(block).items():
            staging[name].copy_(value)
        self._ahead.release(block)
        schedules = dict(zip(self._schedules, self._trainings, strict=True))
        for offset in range(self._block):
            rates = {schedule: training.rate(first + offset) for schedule, training in schedules.items()}
            staging[RATE][offset] = torch.tensor([rates[schedule] for schedule in self._schedules])
        with self._backend.stream(self._copies):
            if block >= HALVES:
                self._copies.wait_event(self._trained[half])
            for name, value in staging.items():
                self._ring[name][half * self._block : (half + 1) * self._block].copy_(value, non_blocking=True)
            self._copied[half].record()
        self._loaded = block + 1

    def _gradients(self, size: int) -> tuple[Tensor, Tensor, Tensor, Sequence[Tensor]]:
        inputs = {name: values.index_select(0, self._place)[0] for name, values in self._ring.items()}
        rates = inputs.pop(RATE)
        inputs = {name: value[:, :size] for name, value in inputs.items()}
        loss, flow = self._model.losses(self._windows.gather(inputs) if self._windows else inputs)
        gradients = torch.autograd.grad(loss.sum(), self._parameters, materialize_grads=True)
        return loss.detach(), flow.detach(), rates, gradients

    def _step(self, result: tuple[Tensor, Tensor, Tensor, Sequence[Tensor]]) -> None:
        loss, flow, rates, gradients = result
        self._optimizer.device_step(gradients, rates, together=len(set(self._schedules)) == 1)
        self._losses.index_copy_(0, self._place, torch.stack([loss, flow])[None])
        self._place.add_(1).remainder_(len(self._losses))


def _schedule(training: Training) -> tuple[object, ...]:
    """What a run's learning rates are a function of."""
    assert training.cfg.optimizer is not None
    return training.cfg.optimizer.lr, repr(training.cfg.scheduler), training.cfg.steps


def _recorded[Result](
    compute: Callable[[], Result], apply: Callable[[Result], None], pool: Any
) -> torch.cuda.CUDAGraph:
    """A graph of ``apply(compute())``; ``compute`` leaves everything as it is, for it is run before recording."""
    aside = torch.cuda.Stream()
    aside.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(aside):
        for _ in range(WARM_UPS):
            compute()
    torch.cuda.current_stream().wait_stream(aside)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph, pool=pool):
        apply(compute())
    return graph


class _Unrecorded:
    """``apply(compute())`` on a CPU."""

    def __init__(self, compute: Callable[[], Any], apply: Callable[[Any], None]):
        self._compute, self._apply = compute, apply

    def replay(self) -> None:
        self._apply(self._compute())
