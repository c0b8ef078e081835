"""Rows of tab:collapse: KL weight and free bits of the posterior x prior and separability of the ring."""

from __future__ import annotations

from dualhead_envs.ring.geometry import PATH_SPREAD
from dualhead_eval.gate import Gate
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.paper.numbers import paper_numbers


def collapse_row(gate: Gate) -> str:
    """The paper's row of a posterior on the two-mode ring; empty if it is none."""
    mechanism = mechanism_of(gate)
    if mechanism.environment != "testbed" or mechanism.latent != "posterior" or mechanism.n_modes != 2:
        return ""
    config = gate.provenance.get("config") or {}
    dataset = (gate.provenance.get("dataset") or {}).get("env_kwargs") or {}
    free_bits = float(config.get("free_bits") or 0.0)
    posterior = f"posterior kl{mechanism.kl_weight:g}" + (f" fb{free_bits:g}" if free_bits else "")
    tight = dataset.get("path_spread", PATH_SPREAD) > PATH_SPREAD
    prior = f"p{mechanism.largest_prior:.2f}"
    where = f"tight {prior}" if tight else f"symmetric {prior}" if prior == "p0.50" else prior
    return f"testbed skew/{posterior}/{where}"


def collapse_number(gate: Gate, quantity: str) -> float | None:
    """What tab:collapse prints for a gate's cell, None where it prints nothing."""
    row = collapse_row(gate)
    found = [p.value for p in paper_numbers() if (p.source, p.row, p.quantity) == ("tab:collapse", row, quantity)]
    return found[0] if found else None
