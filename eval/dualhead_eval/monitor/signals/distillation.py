"""Random network distillation: how badly a network predicts a frozen random one, well only where it was trained."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from dualhead_eval.monitor.signals import perceptron
from dualhead_eval.monitor.signals.standardised import StandardisedNetworks

#: Hidden widths and output of the frozen target and of its predictor.
TARGET, PREDICTOR = (256, 128), (256, 256, 256, 128)


class RandomDistillation(StandardisedNetworks):
    """norm(f(o) - g(o)) of standardised observations, g frozen and random, f trained to predict it."""

    name, networks = "rnd", ("target", "predictor")

    def train(self, rows: torch.Tensor, generator: torch.Generator) -> dict[str, perceptron.Layers]:
        """Draw the target and train its predictor."""
        width = rows.shape[1]
        target = perceptron.orthogonal_network((width, *TARGET), generator).requires_grad_(False)
        predictor = perceptron.orthogonal_network((width, *PREDICTOR), generator)

        def loss(batch: torch.Tensor) -> torch.Tensor:
            return ((predictor(batch) - target(batch)) ** 2).sum(dim=-1).mean()

        perceptron.train(predictor, rows, loss, generator, self.epochs)
        return {"target": perceptron.layers_of(target), "predictor": perceptron.layers_of(predictor)}

    def standardised_score(self, x: NDArray[np.float64]) -> float:
        """Euclidean norm of the prediction error."""
        difference = perceptron.forward(self.layers["predictor"], x) - perceptron.forward(self.layers["target"], x)
        return float(np.linalg.norm(difference))
