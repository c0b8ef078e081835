"""From mode labels to joint tables of counts, with the invalid label kept.

A joint table has one axis a head, each of length K + 1: modes 0..K-1, then index K for invalid samples
(label -1). Nothing is dropped, so valid-pair rates, head-valid marginals and the tables of any two heads
follow from the table of all of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: The label of a sample that reached no mode.
INVALID = -1


def validate_labels(labels: ArrayLike, n_modes: int) -> NDArray[np.int64]:
    """Labels as int64, or a sentence about what is wrong with them.

    Raises:
        ValueError: If a label is not an integer in -1..n_modes-1, or if ``n_modes`` is below 2.
    """
    if n_modes < 2:
        raise ValueError(f"n_modes={n_modes}, expected at least 2: with one mode there is nothing to coordinate")
    array = np.asarray(labels)
    if array.dtype.kind == "f" and not (np.isfinite(array).all() and (array == np.floor(array)).all()):
        raise ValueError("labels contain NaN or fractions, expected integers: use -1 for an invalid sample")
    if array.dtype.kind not in "iuf":
        raise ValueError(f"labels have dtype {array.dtype}, expected integers in -1..{n_modes - 1}")
    array = array.astype(np.int64)
    if array.size and (array.min() < INVALID or array.max() >= n_modes):
        wrong = int(array.min() if array.min() < INVALID else array.max())
        raise ValueError(
            f"label {wrong} is outside 0..{n_modes - 1} and -1 (invalid): label with a partition of {n_modes} modes"
        )
    return array


def joint_table(labels: Sequence[ArrayLike], n_modes: int) -> NDArray[np.int64]:
    """Joint counts of any number of heads.

    Args:
        labels: One array ``(..., n)`` a head, all of one shape: n samples per leading index, in 0..K-1 or -1.
        n_modes: Number of modes K.

    Returns:
        Counts ``(..., K+1, ..., K+1)`` with one trailing axis a head; index K counts invalid samples.

    Raises:
        ValueError: If fewer than two heads are given, shapes differ or labels are out of range.
    """
    if len(labels) < 2:
        raise ValueError(f"labels of {len(labels)} head(s) given, expected two or more: coordination needs a pair")
    heads = [validate_labels(head, n_modes) for head in labels]
    shapes = {head.shape for head in heads}
    if len(shapes) > 1 or heads[0].ndim == 0:
        raise ValueError(
            f"labels have shapes {[head.shape for head in heads]}, expected one shape (..., n): sample the "
            f"heads "
            "together, one label a sample"
        )
    leading, n = heads[0].shape[:-1], heads[0].shape[-1]
    side = n_modes + 1
    cells = side ** len(heads)
    flat = np.zeros(heads[0].shape, dtype=np.int64)
    for head in heads:
        flat = flat * side + np.where(head == INVALID, n_modes, head)
    tables = int(np.prod(leading, dtype=np.int64))
    offset = np.arange(tables, dtype=np.int64)[:, None] * cells
    counts = np.bincount((flat.reshape(tables, n) + offset).ravel(), minlength=tables * cells)
    return counts.astype(np.int64).reshape(*leading, *(side,) * len(heads))


def joint_counts(labels_a: ArrayLike, labels_b: ArrayLike, n_modes: int, *more: ArrayLike) -> NDArray[np.int64]:
    """Joint counts ``(..., K+1, K+1)`` of two heads' labels ``(..., n)``; further heads add an axis each.

    >>> joint_counts([0, 1, 1, -1], [0, 1, 0, 1], n_modes=2).tolist()
    [[1, 0, 0], [1, 1, 0], [0, 1, 0]]

    Raises:
        ValueError: See :func:`joint_table`.
    """
    return joint_table((labels_a, labels_b, *more), n_modes)


def pair_counts(table: NDArray, n_heads: int, first: int = 0, second: int = 1) -> NDArray:
    """The table ``(..., K+1, K+1)`` of heads ``first`` and ``second`` from the joint table of ``n_heads``.

    The other heads are summed out, their invalid samples included.

    Raises:
        ValueError: If the two heads are the same or out of range.
    """
    if first == second or not (0 <= first < n_heads and 0 <= second < n_heads):
        raise ValueError(f"heads {first} and {second} of {n_heads} given, expected two different heads")
    axes = table.ndim - n_heads
    others = tuple(axes + head for head in range(n_heads) if head not in (first, second))
    pair = table.sum(axis=others)
    return pair if first < second else np.swapaxes(pair, -1, -2)


def both_valid(table: NDArray) -> NDArray:
    """The both-valid part ``(..., K, K)`` of a two-head table ``(..., K+1, K+1)``."""
    return table[..., :-1, :-1]


def all_valid_agreement(table: NDArray, n_heads: int) -> tuple[NDArray, NDArray]:
    """Samples in which all heads are valid, and those among them in which all chose one mode.

    Args:
        table: Joint counts with ``n_heads`` trailing axes of length K+1.

    Returns:
        ``(valid, agreeing)`` counts with the leading shape (tab:pose divides the second by the first).
    """
    valid = table
    for axis in range(-n_heads, 0):
        valid = np.moveaxis(np.moveaxis(valid, axis, 0)[:-1], 0, axis)
    agreeing = np.einsum(f"...{'z' * n_heads}->...z", valid)
    return valid.sum(axis=tuple(range(-n_heads, 0))), agreeing.sum(axis=-1)
