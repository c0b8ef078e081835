"""Protocol numbers in a policy's own card."""

from __future__ import annotations

from pathlib import Path

from dualhead_eval.evaluation.samplers import EvaluatedSampler
from dualhead_eval.gate import Gate
from dualhead_eval.statistics.run_summary import residual_mm, summarise_run
from dualhead_eval.statistics.training_record import training_record


def card_numbers(gate: Gate) -> dict[str, float | str]:
    """What a card says of an evaluation: the first two heads at the reference threshold and integration steps."""
    summary = summarise_run(gate)
    numbers: dict[str, float | str] = {
        "conditions": gate.n_conditions,
        "sample pairs per condition": int(gate.table()[0].sum()),
        "threshold tau": gate.reference_tau,
        "Euler steps": gate.reference_nfe,
        "valid-pair rate": summary.valid_rate,
        "capacity C": summary.capacity,
        "effect Delta": summary.delta,
        "rho = Delta / C": summary.rho if summary.rho == summary.rho else "undefined",
        "training loss": training_record(gate).loss,
    }
    residual = residual_mm(gate)
    return numbers if residual is None else numbers | {"cross-head residual (mm)": residual}


def update_card(sampler: EvaluatedSampler, folder: Path, gate: Gate) -> Path:
    """Write the numbers of ``gate`` into the card of the policy that it evaluated.

    Args:
        sampler: The evaluated policy, as :func:`dualhead_eval.evaluation.samplers.open_policy` opened it.
        folder: Its hub folder.
        gate: Its gate.

    Returns:
        The card's path.

    Raises:
        ValueError: If the sampler is no policy.
    """
    from dualhead_policy.modeling_dualhead import DualheadPolicy

    if not isinstance(sampler.sampler, DualheadPolicy):
        raise ValueError("the exact reference has no folder and no card: give a policy")
    return sampler.sampler.write_card(folder, card_numbers(gate))
