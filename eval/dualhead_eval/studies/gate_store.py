"""The gate files of studies: which evaluations are done, which are missing, and every result by its run.

for result in study_results("results/studies/gates"):
    print(result.dataset, result.configuration, result.seed, result.step, result.bank, result.gate)
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from dualhead_eval.gate import Gate, read_gate
from dualhead_eval.gate.compact import CONDITION_DIGITS
from dualhead_eval.studies.gate_identity import refuse_other_evaluation, wanted_policy
from dualhead_eval.studies.packed_gates import PackedGates, packed_name
from dualhead_eval.studies.study_plan import GATE_SUFFIX, StudyEvaluation, StudyPlan

_NAME = re.compile(
    r"(?P<dataset>[^/]+)/(?P<configuration>[^/]+)-(?P<budget>\d+k?)/seed-(?P<seed>\d+)/"
    r"(?P<step>\d+)-(?P<bank>[^/]+)"
)
#: How far a coordinate near zero (m, or of a unit vector) may lie from its other recording.
STATE_MARGIN = 1e-6


@dataclass(frozen=True)
class StudyResult:
    """One gate of a study.

    Attributes:
        dataset, configuration, budget, seed: Its run; the budget in training steps.
        step: Its checkpoint.
        bank: The bank under which it was evaluated.
        gate: The gate.
        file: Where it lies; of a packed gate, the pack and its name there.
    """

    dataset: str
    configuration: str
    budget: int
    seed: int
    step: int
    bank: str
    gate: Gate
    file: Path


class GateStore:
    """Gates in one folder: files as :attr:`StudyEvaluation.gate_file` names them, or in their dataset's pack.

    Args:
        folder: Where they lie.
    """

    def __init__(self, folder: str | Path):
        self.folder = Path(folder)
        self._packed = PackedGates(self.folder)

    def has(self, evaluation: StudyEvaluation) -> bool:
        """Whether there is a gate; :meth:`results` says whether it is the right one.

        Raises:
            ValueError: If the dataset's pack is damaged.
        """
        return self._find(evaluation) is not None

    def _find(self, evaluation: StudyEvaluation) -> tuple[Path, Callable[[], Gate]] | None:
        """Where the gate of an evaluation lies, and how it is read; None if it is not there."""
        file = self.folder / evaluation.gate_file
        if file.is_file():
            return file, partial(read_gate, file)
        dataset, name = packed_name(evaluation.gate_file)
        pack = self._packed.pack(dataset)
        return None if pack is None or name not in pack else (pack.source(name), partial(pack.gate, name))

    def missing(self, plan: StudyPlan) -> list[StudyEvaluation]:
        """Evaluations without a gate, in the plan's order.

        Raises:
            ValueError: If a pack is damaged.
        """
        return [evaluation for evaluation in plan.evaluations if not self.has(evaluation)]

    def results(self, plan: StudyPlan) -> list[StudyResult]:
        """The results of a plan that are there, each held against what the plan asks for.

        Raises:
            ValueError: If a gate file is damaged, or of another configuration, budget, partition or protocol, or if two
                were evaluated on different data; two processors' recordings of the same demonstrations count as one.
        """
        policies = {run.cell: run for run in plan.runs}
        wanted = {cell: wanted_policy(run) for cell, run in policies.items()}
        results = []
        first: dict[str, StudyResult] = {}
        for evaluation in plan.evaluations:
            if (found := self._find(evaluation)) is None:
                continue
            path, read = found
            gate, run = read(), evaluation.run
            dataset = plan.datasets[run.dataset]
            refuse_other_evaluation(gate, evaluation, plan.bank(evaluation), dataset, wanted[run.cell], source=path)
            result = StudyResult(
                run.dataset, run.configuration, run.steps, run.seed, evaluation.step, evaluation.bank, gate, path
            )
            _refuse_other_data(first.setdefault(run.dataset, result), result)
            results.append(result)
        return results


def study_results(folder: str | Path, datasets: Sequence[str] | None = None) -> Iterator[StudyResult]:
    """Every result in a folder of gate files and packs, by name, whichever studies asked for it.

    Args:
        folder: For example ``results/studies/gates``.
        datasets: Only these.

    Raises:
        ValueError: If a gate file or a pack is damaged.
    """
    root = Path(folder)
    packs = PackedGates(root)
    found: dict[str, tuple[Path, Callable[[], Gate]]] = {}
    for dataset in packs.datasets if datasets is None else datasets:
        if (pack := packs.pack(dataset)) is not None:
            for name in pack.names:
                found[f"{dataset}/{name}"] = pack.source(name), partial(pack.gate, name)
    for path in root.rglob(f"*{GATE_SUFFIX}"):
        found["/".join(packed_name(path.relative_to(root)))] = path, partial(read_gate, path)
    for name, (path, read) in sorted(found.items()):
        match = _NAME.fullmatch(name)
        if match is None or (datasets is not None and match["dataset"] not in datasets):
            continue
        budget = match["budget"]
        yield StudyResult(
            match["dataset"],
            match["configuration"],
            int(budget.removesuffix("k")) * (1000 if budget.endswith("k") else 1),
            int(match["seed"]),
            int(match["step"]),
            match["bank"],
            read(),
            path,
        )


def fingerprint(gate: Gate) -> str:
    """Fingerprint of the data that a gate was evaluated on."""
    return str((gate.provenance.get("dataset") or {}).get("fingerprint"))


def training_data(gate: Gate) -> str:
    """Fingerprint of the training split behind a study's gate; empty where it does not say."""
    return str((gate.provenance.get("run") or {}).get("training_data", ""))


def recordings(results: Iterable[StudyResult]) -> dict[str, list[str]]:
    """By dataset, the fingerprints of the training splits behind its results, in the order of the results."""
    found: dict[str, dict[str, None]] = {}
    for result in results:
        found.setdefault(result.dataset, {})[training_data(result.gate)] = None
    return {dataset: list(fingerprints) for dataset, fingerprints in found.items()}


def _refuse_other_data(first: StudyResult, other: StudyResult) -> None:
    compared = (
        ("evaluated on data", fingerprint(first.gate), fingerprint(other.gate)),
        ("trained on data", training_data(first.gate), training_data(other.gate)),
    )
    if all(mine != theirs for _, mine, theirs in compared) and _same_states(first.gate, other.gate):
        return  # the same demonstrations, recorded on another processor
    for what, mine, theirs in compared:
        if mine != theirs:
            raise ValueError(
                f"{other.file} was {what} {theirs[:12]!r}, {first.file} on {mine[:12]!r}, expected one recording of "
                f"{first.dataset}: move one of them away"
            )


def _same_states(one: Gate, other: Gate) -> bool:
    """Whether two gates hold the same states, as far as the smaller bank goes, up to a gate's rounding.

    A recording is a function of its arguments on one kind of processor; on another its last bits differ (NumPy and
    BLAS choose their instructions by the processor), and with them every fingerprint.
    """
    count = min(len(one.conditions), len(other.conditions))
    return np.array_equal(one.pair_ids[:count], other.pair_ids[:count]) and np.allclose(
        one.conditions[:count], other.conditions[:count], rtol=10.0 ** (1 - CONDITION_DIGITS), atol=STATE_MARGIN
    )
