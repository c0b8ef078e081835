"""Merging gate files: more samples of the same conditions, or more conditions of the same run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.gate.compact import CONDITION_DIGITS, rounded
from dualhead_eval.gate.file import gate_digest
from dualhead_eval.gate.gate import ROLLOUTS, Gate


def merge_gates(gates: Sequence[Gate]) -> Gate:
    """One gate from several of the same run, as if everything had been evaluated together.

    Conditions with the same pair id and state add their counts; others are appended. Residual strata are
    dropped where conditions are shared, because a median and a U cannot be added.

    Raises:
        ValueError: If the gates differ in heads, modes, partition, thresholds, steps or label, or one is
            given twice.
    """
    if not gates:
        raise ValueError("no gate was given, expected one or more to merge")
    first = gates[0]
    for other in gates[1:]:
        for name in (
            "heads",
            "n_modes",
            "partition",
            "taus",
            "nfes",
            "reference_tau",
            "reference_nfe",
            "label",
        ):
            mine, theirs = getattr(first, name), getattr(other, name)
            if mine != theirs:
                raise ValueError(
                    f"gates with {name}={mine} and {theirs} given, expected the same: merge like with like"
                )
        mine, theirs = first.target_probabilities, other.target_probabilities
        if (None if mine is None else mine.tolist()) != (None if theirs is None else theirs.tolist()):
            raise ValueError("gates with different target_probabilities given, expected the same data")
    digests = [gate_digest(gate) for gate in gates]
    if len(set(digests)) != len(digests):
        raise ValueError(
            "the same gate was given twice, expected different evaluations: its samples would count double"
        )

    rows: dict[tuple, int] = {}
    counts: list[NDArray[np.int64]] = []
    conditions, pair_ids = [], []
    shared = False
    for gate in gates:
        for index, key in enumerate(_keys(gate)):
            table = gate.counts[:, :, index]
            if key in rows:
                counts[rows[key]] = counts[rows[key]] + table
                shared = True
                continue
            rows[key] = len(counts)
            counts.append(table)
            conditions.append(gate.conditions[index])
            pair_ids.append(gate.pair_ids[index])
    strata = {}
    if not shared:
        for name in set.intersection(*(set(gate.strata) for gate in gates)):
            parts = [gate.strata[name] for gate in gates]
            fields = ("n", "total", "squares", "median", "u")
            strata[name] = replace(parts[0], **{f: np.concatenate([getattr(p, f) for p in parts], 2) for f in fields})
    provenance = first.provenance | {"merged_from": digests}
    merged = np.stack(counts, axis=2)
    if "pairs_per_condition" in provenance:
        sampled = merged[0, 0].reshape(len(counts), -1).sum(axis=1)
        provenance["pairs_per_condition"] = int(sampled[0]) if (sampled == sampled[0]).all() else None
    return replace(
        first,
        counts=merged,
        conditions=np.array(conditions),
        pair_ids=np.array(pair_ids),
        provenance=provenance,
        strata=strata,
    )


def _keys(gate: Gate) -> list[tuple[float, ...]]:
    """What tells the conditions of a gate apart: pair and state, as far as a compact gate knows it.

    Decisions of recorded episodes are never compact, and neighbours may differ by less than its digits.
    """
    recorded = gate.provenance.get("method") == ROLLOUTS
    states = gate.conditions if recorded else rounded(gate.conditions, CONDITION_DIGITS)
    return [(int(pair), *state) for pair, state in zip(gate.pair_ids, states.tolist(), strict=True)]
