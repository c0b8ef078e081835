"""The recorded windows of N runs on their device, gathered for all runs at once."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from dualhead_policy.training.recorded_windows import RecordedWindows
from dualhead_policy.training.stacked.step_inputs import START, StepInputs


class DeviceWindows:
    """Frames of every run's split; what several runs share is held once.

    Args:
        sources: The runs' windows, of splits of equal shape.
    """

    def __init__(self, sources: Sequence[RecordedWindows]):
        self._arrays = {
            name: _Rows([getattr(source, name) for source in sources])
            for name in ("observation", "action", "last_frame", "token")
            if getattr(sources[0], name) is not None
        }
        self._steps = sources[0].steps

    def gather(self, inputs: StepInputs) -> StepInputs:
        """The inputs with windows (N, B, ...) in place of their first frames."""
        rest = dict(inputs)
        start = rest.pop(START)
        frames = torch.minimum(start[..., None] + self._steps, self._arrays["last_frame"].at(start)[..., None])
        windows = {"observation": self._arrays["observation"].at(start), "action": self._arrays["action"].at(frames)}
        if "token" in self._arrays:
            windows["token"] = self._arrays["token"].at(start)
        return windows | rest


class _Rows:
    """One array per run, (F, ...) each, looked up in one operation."""

    def __init__(self, arrays: Sequence[Tensor]):
        held: list[Tensor] = []
        place: dict[int, int] = {}
        for array in arrays:
            if array.data_ptr() not in place:
                place[array.data_ptr()] = len(held)
                held.append(array)
        self._values = torch.cat(held)
        offsets = [place[array.data_ptr()] * len(arrays[0]) for array in arrays]
        self._offset = torch.tensor(offsets, device=self._values.device)

    def at(self, index: Tensor) -> Tensor:
        """Rows (N, ..., *) at the frames ``index`` (N, ...) of every run's array."""
        return self._values[index + self._offset.reshape(-1, *[1] * (index.ndim - 1))]
