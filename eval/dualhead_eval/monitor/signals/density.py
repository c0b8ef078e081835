"""Log density of the observation by a flow from data to noise, in one step (logpZO of FAIL-Detect)."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from dualhead_eval.monitor.signals import perceptron
from dualhead_eval.monitor.signals.standardised import StandardisedNetworks

#: Hidden widths of the velocity field.
HIDDEN = (256, 256, 256)


class FlowDensity(StandardisedNetworks):
    """norm(o + v(o, 0))^2 of standardised observations: where one step of the flow lands, in the noise's distance.

    v is trained by flow matching on x_t = (1 - t) o + t z with z standard normal, whose velocity is z - o.
    """

    name, networks = "logpzo", ("velocity",)

    def train(self, rows: torch.Tensor, generator: torch.Generator) -> dict[str, perceptron.Layers]:
        """Train the velocity field; time is its last input."""
        width = rows.shape[1]
        velocity = perceptron.orthogonal_network((width + 1, *HIDDEN, width), generator)

        def loss(batch: torch.Tensor) -> torch.Tensor:
            noise = torch.randn(batch.shape, generator=generator)
            time = torch.rand((len(batch), 1), generator=generator)
            point = torch.cat([(1 - time) * batch + time * noise, time], dim=1)
            return ((velocity(point) - (noise - batch)) ** 2).sum(dim=-1).mean()

        perceptron.train(velocity, rows, loss, generator, self.epochs)
        return {"velocity": perceptron.layers_of(velocity)}

    def standardised_score(self, x: NDArray[np.float64]) -> float:
        """Squared norm of the noise that the flow assigns."""
        noise = x + perceptron.forward(self.layers["velocity"], np.append(x, 0.0))
        return float((noise**2).sum())
