"""The protocol of an evaluation: pairs, integration steps and thresholds, and the seed of each group of conditions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dualhead_policy.sampling import NOISE_ALIGNMENTS, TOKEN_DRAWS, SamplingCoupling

#: The frozen protocol (sec:gate): 64 samples in each of 20 draws per condition, 20 Euler steps.
FROZEN_PAIRS = 64 * 20
FROZEN_NFE = 20
#: Conditions sampled together; their draws are keyed by the protocol's seed, the NFE and the group's number.
CONDITIONS_PER_GROUP = 25


@dataclass(frozen=True)
class EvaluationProtocol:
    """How to evaluate; the defaults are the frozen protocol.

    Attributes:
        pairs: Sample pairs per condition.
        nfes: Numbers of Euler steps (NFE) to scan; the first is the reference.
        taus: Thresholds to scan beside the partition's own, which is the reference.
        seed: Seed of all draws.
        coupling: What the heads share.

    Raises:
        ValueError: If a number is outside its range, or an NFE is given twice.
    """

    pairs: int = FROZEN_PAIRS
    nfes: Sequence[int] = (FROZEN_NFE,)
    taus: Sequence[float] = ()
    seed: int = 0
    coupling: SamplingCoupling = field(default_factory=SamplingCoupling)

    def __post_init__(self) -> None:
        if self.pairs < 1:
            raise ValueError(f"pairs={self.pairs} is not positive: sample at least 1 pair per condition")
        if not self.nfes or min(self.nfes) < 1 or len(set(self.nfes)) != len(self.nfes):
            raise ValueError(
                f"nfes={list(self.nfes)}, expected one or more different numbers of steps, each at least 1"
            )
        if not all(math.isfinite(tau) and tau > 0 for tau in self.taus):
            raise ValueError(f"taus={list(self.taus)}, expected finite thresholds above 0: give others")
        if self.seed < 0:
            raise ValueError(f"seed={self.seed} is negative: give 0 or more")
        require_coupling(self.coupling)

    @property
    def reference_nfe(self) -> int:
        """The NFE of headline numbers."""
        return self.nfes[0]

    def groups(self, n_conditions: int) -> list[slice]:
        """The conditions that are sampled together, as slices in order."""
        starts = range(0, n_conditions, CONDITIONS_PER_GROUP)
        return [slice(start, min(start + CONDITIONS_PER_GROUP, n_conditions)) for start in starts]

    def group_seeds(self, nfe: int, group: int, count: int = 1) -> list[int]:
        """Independent seeds of the draws of one group; a longer list begins with a shorter one.

        Args:
            nfe: Euler steps.
            group: The group's number in :meth:`groups`.
            count: Seeds wanted: one for a policy, further ones for what is drawn beside it.
        """
        words = np.random.SeedSequence([self.seed, nfe, group]).generate_state(count, np.uint64)
        return [int(word >> np.uint64(1)) for word in words]

    def describe(self) -> dict[str, Any]:
        """What a gate's provenance says of the protocol, beside the NFEs and thresholds that the gate holds."""
        return {
            "pairs_per_condition": self.pairs,
            "seed": self.seed,
            "coupling": described_coupling(self.coupling),
        }


def described_coupling(coupling: SamplingCoupling) -> dict[str, Any]:
    """What a gate's provenance says of a coupling; what is younger than gates only where it is not the policy's own."""
    said: dict[str, Any] = {"source_noise_beta": coupling.source_noise_beta, "share_token": coupling.share_token}
    younger = {"token_draw": coupling.token_draw, "source_noise_alignment": coupling.source_noise_alignment}
    return said | {name: value for name, value in younger.items() if value is not None}


def coupling_provenance(coupling: SamplingCoupling | None) -> dict[str, Any]:
    """The entry of a provenance about a policy that is sampled under a coupling; none where it is its own."""
    return {} if coupling is None else {"coupling": described_coupling(coupling)}


def require_coupling(coupling: SamplingCoupling) -> None:
    """Refuse a coupling that no policy can be sampled under.

    Raises:
        ValueError: If beta lies outside [0, 1], or an alignment or a draw of tokens is unknown.
    """
    beta = coupling.source_noise_beta
    if beta is not None and not 0 <= beta <= 1:
        raise ValueError(f"source_noise_beta={beta} is outside [0, 1]: give 1 (private) to 0 (shared noise)")
    if coupling.source_noise_alignment not in (None, *NOISE_ALIGNMENTS):
        raise ValueError(
            f"source_noise_alignment={coupling.source_noise_alignment!r} is none of "
            f"{', '.join(NOISE_ALIGNMENTS)}: give one of them, or leave it out"
        )
    if coupling.token_draw not in (None, *TOKEN_DRAWS):
        raise ValueError(f"token_draw={coupling.token_draw!r} is none of {', '.join(TOKEN_DRAWS)}: give one of them")
