"""The claims of tab:claims in its order, each graded by a criterion of its own.

A grade says what the runs show by the criterion named beside it; a claim whose runs are missing is not graded.
Nothing here pools seeds before the effect is formed.
"""

from __future__ import annotations

from collections.abc import Sequence

from dualhead_eval.paper.claims.bound import grade_bound
from dualhead_eval.paper.claims.consistency import grade_consistency
from dualhead_eval.paper.claims.grade import UNGRADED, Grade, Measured
from dualhead_eval.paper.claims.latent import grade_latent
from dualhead_eval.paper.claims.shared_noise import grade_shared_noise
from dualhead_eval.paper.claims.tokens import grade_tokens
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.statistics.run import Run

#: Claims about failure monitors on the external benchmark, whose traces are no gate files.
MONITOR_CLAIMS = (
    "Benign multimodality raises residual false alarms",
    "Coordination shrinks the multimodal false-alarm surcharge",
    "Coordination improves failure detection",
    "Low capacity and token entropy explain the external null",
)


def grade_claims(runs: Sequence[Run]) -> list[Grade]:
    """Grades of every claim of tab:claims, in its order.

    Ring runs whose valid-pair rate is too low are left out of every claim but the first: they are under-trained. On the
    robots a low rate is a finding of its own, the cost of consistency, and stays.
    """
    kept = [run for run in runs if run.first.readable or run.first.partition != "ring"]
    measured = [Measured(run, mechanism_of(run.gate)) for run in kept]
    external = "the external benchmark's traces are not among the runs"
    return [
        grade_bound(runs),
        grade_latent(measured),
        grade_shared_noise(measured),
        grade_consistency(measured),
        grade_tokens(measured),
        *(Grade(claim, UNGRADED, external, "needs the LIBERO-Plus monitor experiment") for claim in MONITOR_CLAIMS),
    ]
