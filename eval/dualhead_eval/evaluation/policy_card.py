"""Protocol numbers in a policy's own card."""

from __future__ import annotations

from pathlib import Path

from dualhead_eval.gate import Gate
from dualhead_eval.statistics.run_summary import residual_mm, summarise_run
from dualhead_policy.pretrained import load_policy, policy_folder


def card_numbers(gate: Gate) -> dict[str, float]:
    """What a card says of an evaluation: the first two heads at the reference threshold and integration steps."""
    summary = summarise_run(gate)
    numbers = {
        "conditions": gate.n_conditions,
        "sample pairs per condition": int(gate.table()[0].sum()),
        "threshold tau": gate.reference_tau,
        "Euler steps": gate.reference_nfe,
        "valid-pair rate": summary.valid_rate,
        "capacity C": summary.capacity,
        "effect Delta": summary.delta,
        "rho = Delta / C": summary.rho,
    }
    residual = residual_mm(gate)
    return numbers if residual is None else numbers | {"cross-head residual (mm)": residual}


def write_card_numbers(policy: str | Path, gate: Gate) -> Path:
    """Write the numbers of ``gate`` into the card of the policy that it evaluated; returns the card's path."""
    folder = policy_folder(policy)
    load_policy(folder)[0].write_card(folder, card_numbers(gate))
    return folder / "README.md"
