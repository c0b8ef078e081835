"""Options for the source noise that a dual-head policy's heads share in sampling, however they were trained."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dualhead_policy.sampling import SamplingCoupling


def add_source_noise_options(parser: argparse._ActionsContainer) -> None:
    """Define ``--source-noise-beta`` and ``--source-noise-alignment``."""
    parser.add_argument("--source-noise-beta", type=float, metavar="B", help="1 private noise, 0 shared noise")
    parser.add_argument(
        "--source-noise-alignment",
        choices=["kinematic"],
        help="shared noise goes from joint to position head through the kinematic map, not coordinate by coordinate",
    )


def given_source_noise(args: argparse.Namespace) -> SamplingCoupling | None:
    """What the options ask for; None: as the policy was trained.

    Raises:
        ValueError: If beta lies outside [0, 1].
    """
    from dualhead_eval.evaluation.protocol import require_coupling
    from dualhead_policy.sampling import SamplingCoupling

    coupling = SamplingCoupling(
        source_noise_beta=args.source_noise_beta, source_noise_alignment=args.source_noise_alignment
    )
    require_coupling(coupling)
    return None if coupling == SamplingCoupling() else coupling
