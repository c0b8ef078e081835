"""The inputs of one run's steps on the CPU, without its model: it can be sent to another process."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dualhead_policy.flow.draw_rule import DrawRule
from dualhead_policy.training.fresh_ring_paths import FreshRingPaths
from dualhead_policy.training.stacked.step_inputs import START, StepInputs, batch_inputs, draw_inputs
from dualhead_policy.training.window_order import WindowOrder

if TYPE_CHECKING:
    from dualhead_policy.training.trainer import Training


@dataclass(frozen=True)
class RunFeed:
    """The inputs of one run.

    Attributes:
        rule: What its steps draw.
        windows: Its recorded windows, named by their first frames alone, the arrays being where the model is; or the
            paths that it draws.
    """

    rule: DrawRule
    windows: WindowOrder | FreshRingPaths

    @classmethod
    def of(cls, training: Training) -> RunFeed:
        """The inputs of a training."""
        from dualhead_policy.flow.draws import draw_rule

        source, first = training.source, training.source.batch(0)
        rule = draw_rule(
            training.policy.model,
            first.observation.shape[1],
            seed=training.policy.config.seed or 0,
            has_tokens=first.token is not None,
        )
        return cls(rule, source if isinstance(source, FreshRingPaths) else source.order)

    def size(self, step: int) -> int:
        """Windows in the batch of training step ``step``."""
        return self.windows.size(step)

    def inputs(self, step: int) -> StepInputs:
        """Draws and windows, or the windows' first frames, of training step ``step``."""
        draws = draw_inputs(self.rule.draw(self.size(step), step))
        if isinstance(self.windows, WindowOrder):
            return {START: self.windows.starts(step)} | draws
        return batch_inputs(self.windows.drawn(step)) | draws
