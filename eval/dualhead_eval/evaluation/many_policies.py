"""Many policies under one protocol: the conditions are opened once, and each gate is written as soon as it is done.

A policy draws what it would have drawn alone, so that its gate is the one of evaluating it alone. One policy's samples
fill a processor's matrix products already (``benchmarks/evaluation_speed.py``), so that the policies' weights are not
stacked.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from dualhead_eval.evaluation.conditions import ConditionBank
from dualhead_eval.evaluation.open_loop import PairSource, evaluate, gate_provenance
from dualhead_eval.evaluation.protocol import EvaluationProtocol
from dualhead_eval.gate import Gate, read_gate, write_gate

#: Parts of a policy's path that its run's name is not among.
_LAYOUT = ("checkpoints", "pretrained_model", "last")


def evaluate_policies(
    policies: Sequence[tuple[str | Path, PairSource]],
    conditions: ConditionBank,
    protocol: EvaluationProtocol,
    folder: str | Path,
    *,
    own_steps: bool = False,
    overwrite: bool = False,
    progress: Callable[[int], object] | None = None,
) -> dict[Path, Gate]:
    """Evaluate policies into ``folder/NAME.gate.json``, NAME being each run's.

    All policies are checked before the first is evaluated, so that one that does not fit costs nothing. Gate files of
    the same checkpoint, conditions and protocol, which an interrupted call has left, are kept.

    Args:
        policies: Each with its path: a hub folder, or a training run's output folder.
        conditions: What to evaluate under.
        protocol: Pairs, NFEs, thresholds, seed and coupling.
        folder: Where the gate files go.
        own_steps: Whether every policy takes its own number of steps instead of the protocol's.
        overwrite: Whether to replace gate files of other evaluations.
        progress: Called with the number of conditions done, or kept, at each NFE.

    Returns:
        Gates by file, in the order of ``policies``.

    Raises:
        FileExistsError: If a file holds something else and ``overwrite`` is false.
        ValueError: If two policies have one name or are one checkpoint, or one does not fit the conditions.
    """
    files: dict[Path, PairSource] = {}
    protocols: dict[Path, EvaluationProtocol] = {}
    kept: dict[Path, Gate] = {}
    known: dict[str, str | Path] = {}
    for path, sampler in policies:
        file = Path(folder) / f"{run_name(path)}.gate.json"
        if file in files:
            raise ValueError(f"two policies are called {run_name(path)!r}: rename a folder, or evaluate them apart")
        files[file] = sampler
        protocols[file] = replace(protocol, nfes=(sampler.default_nfe,)) if own_steps else protocol
        try:
            files[file].require_conditions(conditions)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
        checkpoint = files[file].provenance["checkpoint"]
        if checkpoint in known:
            raise ValueError(f"{known[checkpoint]} and {path} hold the same checkpoint: leave one of them out")
        known[checkpoint] = path
        if file.exists():
            found = _same_evaluation(file, files[file], conditions, protocols[file])
            if found is not None:
                kept[file] = found
            elif not overwrite:
                raise FileExistsError(f"{file} holds another evaluation: choose another folder or add --overwrite")
    gates = {}
    for file, sampler in files.items():
        if file in kept:
            gates[file] = kept[file]
            if progress is not None:
                progress(len(conditions) * len(protocol.nfes))
            continue
        gates[file] = evaluate(sampler, conditions, protocols[file], _label(file), progress=progress)
        write_gate(gates[file], file, overwrite=overwrite)
    return gates


def run_name(path: str | Path) -> str:
    """What a policy's run is called: the last folder of its path that is not a checkpoint's.

    >>> run_name("outputs/oracle/checkpoints/050000/pretrained_model"), run_name("outputs/oracle")
    ('oracle', 'oracle')
    """
    parts = [part for part in Path(path).absolute().parts if part not in _LAYOUT and not part.isdecimal()]
    return parts[-1]


def _label(file: Path) -> str:
    return file.name.removesuffix(".gate.json")


def _same_evaluation(
    file: Path, sampler: PairSource, conditions: ConditionBank, protocol: EvaluationProtocol
) -> Gate | None:
    """The gate in ``file`` if it is what evaluating would give, None if it is another."""
    gate = read_gate(file)
    wanted = json.loads(json.dumps(gate_provenance(sampler, conditions, protocol, _label(file))))
    same = all(gate.provenance.get(name) == value for name, value in wanted.items())
    taus = sorted({float(conditions.partition.tau), *map(float, protocol.taus)})
    points = (gate.taus, gate.nfes, gate.reference_nfe) == (taus, sorted(protocol.nfes), protocol.reference_nfe)
    return gate if same and points and gate.pair_ids.tolist() == conditions.pair_ids.tolist() else None
