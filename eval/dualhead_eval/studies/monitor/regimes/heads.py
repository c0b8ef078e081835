"""Both heads of a regime: who shares which token, and how often they go to different modes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import brentq

from dualhead_envs.ring.partition import RingPartition
from dualhead_eval.exact_reference import ExactReference
from dualhead_eval.residuals.distances import position_residual_mm
from dualhead_eval.studies.monitor.regimes.definition import Cell, SamplerOptions
from dualhead_policy.flow.keyed_random import keyed_generator
from dualhead_policy.sampling import SamplingCoupling

#: No token; a token for each head; one token for both. Each takes away what the one before it has.
Arm = Literal["none", "apart", "shared"]
ARMS: tuple[Arm, ...] = get_args(Arm)


@dataclass(frozen=True)
class Drawn:
    """Decisions of one arm.

    Attributes:
        residual: Distance of the two decodings in mm ``(n,)``.
        sides: The mode that each head's chunk is nearer to ``(n, 2)``, without a threshold.
        obedience: Share of chunks on the side of the mode of their token, over the heads whose token is known (both, or
            the first one where each has its own); None without tokens.
    """

    residual: NDArray[np.float64]
    sides: NDArray[np.int64]
    obedience: float | None

    @property
    def crossed(self) -> NDArray[np.bool_]:
        """Whether the heads' chunks lie on two sides ``(n,)``."""
        return self.sides[:, 0] != self.sides[:, 1]


@dataclass(frozen=True)
class Heads:
    """The exact reference of a cell under one arm; both heads have one law.

    Args:
        cell: The regime.
        arm: What the heads share.
        options: Representation, Euler steps and seed.
    """

    cell: Cell
    arm: Arm
    options: SamplerOptions

    @property
    def reference(self) -> ExactReference:
        """The sampler at flagged decisions."""
        if self.arm == "none":
            return self._reference([self.cell.prior, 1 - self.cell.prior])
        return self._reference(
            [self.cell.prior, 1 - self.cell.prior],
            token="oracle",
            token_replacement_prob=self.cell.replacement,
            token_draw=self.token_probabilities,
        )

    @property
    def token_probabilities(self) -> list[float]:
        """How likely each token is."""
        rare = rarer_token(self.cell.token_entropy)
        return [1 - rare, rare]

    @property
    def mismatch(self) -> float:
        """x: share of flagged pairs whose heads go to different modes, by the law that they are sampled from."""
        if self.arm == "none":
            return float(1 - np.square(self.reference.generator.probabilities).sum())
        token, given = np.array(self.token_probabilities), self.reference.mode_given_token().double().numpy()
        if self.arm == "apart":
            return float(1 - np.square(token @ given).sum())
        return float(token @ (1 - np.square(given).sum(axis=1)))

    def flagged(self, n: int, purpose: str) -> Drawn:
        """``n`` decisions with both modes in the data, the same ones for one purpose."""
        return self._pairs(self.reference, n, f"{purpose}, flagged")

    def other(self, n: int, purpose: str) -> Drawn:
        """``n`` decisions with the first mode alone in the data; a token could not tell the heads anything there."""
        return self._pairs(self._reference([1.0, 0.0]), n, f"{purpose}, other")

    def _reference(self, prior: list[float], **token: Any) -> ExactReference:
        angles = [0.0, self.cell.mode_angle]
        return ExactReference(2, self.options.representation, mode_probabilities=prior, mode_angles=angles, **token)

    def _pairs(self, reference: ExactReference, n: int, purpose: str) -> Drawn:
        key = tuple(repr(value) for value in self.cell.model_dump().values())
        generator = keyed_generator(self.options.seed, self.arm, purpose, *key)
        conditions = reference.generator.draw_conditions(np.random.default_rng(generator.initial_seed()), n)
        samples = reference.sample(
            {"observation.environment_state": torch.from_numpy(conditions)},
            1,
            num_steps=self.options.euler_steps,
            coupling=SamplingCoupling(share_token=self.arm != "apart"),
            generator=generator,
        )
        a = reference.map.to_position(samples.joint[:, 0].double().numpy())
        b = samples.position[:, 0].double().numpy()
        partition = RingPartition(2, reference.generator.angles)
        sides = np.stack([partition.score(path, conditions)[0] for path in (a, b)], axis=-1)
        obedience = None
        if samples.token is not None:
            known = sides[:, :1] if self.arm == "apart" else sides
            obedience = float((known == samples.token.numpy()).mean())
        return Drawn(position_residual_mm(a, b), sides, obedience)


def rarer_token(entropy: float) -> float:
    """Probability of the rarer of two tokens whose distribution has this entropy in nat.

    >>> round(rarer_token(0.012), 4), rarer_token(math.log(2))
    (0.0016, 0.5)
    """
    if entropy >= math.log(2):
        return 0.5
    return float(brentq(lambda q: -q * math.log(q) - (1 - q) * math.log1p(-q) - entropy, 1e-12, 0.5, xtol=1e-14))
