"""Compact gates: what a study commits by the hundred, without digits that mean nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.gate.gate import Gate
from dualhead_eval.residuals.strata import ResidualStrata

#: Significant digits of a condition: they say which one it was (the fingerprint holds the file to the last bit).
CONDITION_DIGITS = 5
#: Significant digits of sums and medians of residuals, well inside the rounding that a gate's checks allow.
RESIDUAL_DIGITS = 11


def compact_gate(gate: Gate, *, residuals: bool = True) -> Gate:
    """``gate`` with its conditions and residuals rounded; counts stay exact.

    Args:
        gate: Any gate.
        residuals: Whether to keep the residual strata, which make up nine tenths of a file.
    """
    strata = {name: _rounded_strata(component) for name, component in gate.strata.items()} if residuals else {}
    return replace(gate, conditions=rounded(gate.conditions, CONDITION_DIGITS), strata=strata)


def rounded(array: NDArray[np.float64], digits: int) -> NDArray[np.float64]:
    """``array`` with every number at its nearest with so many significant digits.

    >>> rounded(np.array([123.456, -0.000123456, 0.0, np.nan]), 3)
    array([ 1.23e+02, -1.23e-04,  0.00e+00,       nan])
    """
    flat = [float(f"{value:.{digits - 1}e}") for value in np.asarray(array, dtype=np.float64).ravel()]
    return np.array(flat, dtype=np.float64).reshape(np.shape(array))


def _rounded_strata(strata: ResidualStrata) -> ResidualStrata:
    total, squares, median = (rounded(x, RESIDUAL_DIGITS) for x in (strata.total, strata.squares, strata.median))
    return replace(strata, total=total, squares=squares, median=median)
