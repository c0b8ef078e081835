"""A signal on standardised observations with networks of its own: what random distillation and density share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from dualhead_eval.monitor.decision import Decision
from dualhead_eval.monitor.signals import perceptron
from dualhead_eval.monitor.signals.observation import CONSTANT
from dualhead_eval.monitor.signals.signal import Signal, stacked_observations


class StandardisedNetworks(Signal):
    """A learned score of the observation, standardised by the fitted mean and deviation.

    Args:
        epochs: Passes over the observations in training.
    """

    unit, needs, learns = "1", frozenset({"observation"}), True
    networks: tuple[str, ...]

    def __init__(self, epochs: int = perceptron.EPOCHS) -> None:
        if epochs < 1:
            raise ValueError(f"epochs={epochs}, expected at least 1")
        self.epochs = epochs
        self.mean: NDArray[np.float64] | None = None
        self.scale: NDArray[np.float64] | None = None
        self.layers: dict[str, perceptron.Layers] = {}

    def fit(self, decisions: Sequence[Decision], rng: np.random.Generator) -> None:
        """Standardise the observations and train."""
        observations = stacked_observations(decisions)
        self.mean, scale = observations.mean(axis=0), observations.std(axis=0)
        self.scale = np.where(scale >= CONSTANT, scale, 1.0)
        rows = torch.from_numpy((observations - self.mean) / self.scale).float()
        generator = torch.Generator().manual_seed(int(rng.integers(2**63 - 1)))
        self.layers = self.train(rows, generator)

    def train(self, rows: torch.Tensor, generator: torch.Generator) -> dict[str, perceptron.Layers]:
        """Train the networks on standardised observations ``(N, D)``."""
        raise NotImplementedError

    def score(self, decision: Decision) -> float:
        """The score of the standardised observation."""
        if self.mean is None or self.scale is None:
            raise ValueError(f"{self.name} has not been fitted, expected a call of fit before the first score")
        return self.standardised_score((decision.observation - self.mean) / self.scale)

    def standardised_score(self, x: NDArray[np.float64]) -> float:
        """The score of a standardised observation ``(D,)``."""
        raise NotImplementedError

    def options(self) -> dict[str, Any]:
        """Passes over the observations."""
        return {"epochs": self.epochs}

    def learned(self) -> dict[str, NDArray]:
        """Mean, deviation and weights."""
        if self.mean is None or self.scale is None:
            return {}
        arrays = {"mean": self.mean, "scale": self.scale}
        for name, layers in self.layers.items():
            arrays |= perceptron.named(layers, name)
        return arrays

    def restore(self, arrays: dict[str, NDArray]) -> None:
        """Take them back."""
        self.mean, self.scale = arrays["mean"], arrays["scale"]
        self.layers = {name: perceptron.unnamed(arrays, name) for name in self.networks}
