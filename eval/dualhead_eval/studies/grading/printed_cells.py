"""Cells of the paper's tables that are no rows of its main ones: tab:collapse, tab:grid, tab:pose."""

from __future__ import annotations

from typing import Any

from dualhead_envs.ring.geometry import PATH_SPREAD
from dualhead_eval.gate import Gate
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.paper.numbers import paper_row

#: Effects of tab:pose by the pair of heads.
POSE_EFFECTS = {
    ("joint", "position"): "delta_joint_pos",
    ("joint", "rotation"): "delta_joint_rot",
    ("position", "rotation"): "delta_pos_rot",
}


def collapse_row(gate: Gate) -> str:
    """tab:collapse, KL weight and free bits x prior and separability: a posterior on the two-mode ring, else empty."""
    mechanism = mechanism_of(gate)
    if mechanism.environment != "testbed" or mechanism.latent != "posterior" or mechanism.n_modes != 2:
        return ""
    free_bits = float(_config(gate).get("free_bits") or 0.0)
    posterior = f"posterior kl{mechanism.kl_weight:g}" + (f" fb{free_bits:g}" if free_bits else "")
    dataset = (gate.provenance.get("dataset") or {}).get("env_kwargs") or {}
    tight = dataset.get("path_spread", PATH_SPREAD) > PATH_SPREAD
    prior = f"p{mechanism.largest_prior:.2f}"
    where = f"tight {prior}" if tight else f"symmetric {prior}" if prior == "p0.50" else prior
    return f"testbed skew/{posterior}/{where}"


def grid_row(gate: Gate) -> str:
    """tab:grid, beta x lambda: two heads on v2 that neither token nor latent couples; empty if it is none."""
    mechanism = mechanism_of(gate)
    if mechanism.environment != "v2" or not mechanism.standard or mechanism.token or mechanism.latent:
        return ""
    return f"v2/grid beta{mechanism.beta:g} lambda{mechanism.consistency:g}/seed0"


def pose_row(gate: Gate) -> str:
    """tab:pose, lambda_cons x lambda_rot: three heads on v3; empty if it is none."""
    mechanism = mechanism_of(gate)
    other = mechanism.token or mechanism.latent or mechanism.alignment
    if mechanism.environment != "v3" or "rotation" not in gate.heads or other:
        return ""
    rotation = float(_config(gate).get("rotation_consistency_weight") or 0.0)
    return f"v3/pose lambda_cons{mechanism.consistency:g} lambda_rot{rotation:g}/seed0"


#: The row of a gate in each of these tables.
ROWS = {"tab:collapse": collapse_row, "tab:grid": grid_row, "tab:pose": pose_row}


def printed_number(gate: Gate, source: str, quantity: str) -> float | None:
    """What one of these tables prints for a gate's cell, None where it prints nothing.

    Args:
        gate: The gate.
        source: The table, a key of :data:`ROWS`.
        quantity: Which of its numbers.
    """
    figure = paper_row(ROWS[source](gate), (source,)).get(quantity)
    return None if figure is None else figure.value


def _config(gate: Gate) -> dict[str, Any]:
    return gate.provenance.get("config") or {}
