"""One evaluation of a study: a run's checkpoint under a bank, into the compressed gate file that stands for it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from dualhead_eval.evaluation.conditions import ConditionBank
from dualhead_eval.evaluation.open_loop import PairSource, evaluate
from dualhead_eval.evaluation.protocol import EvaluationProtocol
from dualhead_eval.gate import Gate, write_gate
from dualhead_eval.gate.compact import compact_gate
from dualhead_eval.studies.study_file import Bank
from dualhead_eval.studies.study_plan import StudyEvaluation


def evaluate_study_run(
    evaluation: StudyEvaluation,
    bank: Bank,
    sampler: PairSource,
    conditions: ConditionBank,
    folder: str | Path,
    *,
    training_data: str,
    precision: str,
    device: str,
    progress: Callable[[int], object] | None = None,
) -> Gate:
    """Evaluate a checkpoint and write its gate file.

    Args:
        evaluation: What is evaluated.
        bank: Its bank.
        sampler: The checkpoint, opened with :func:`dualhead_eval.evaluation.samplers.open_policy`; draws of one head
            where its row asks for them.
        conditions: The whole test split of its dataset.
        folder: Folder of the gate files.
        training_data: Fingerprint of the training split.
        precision: Type in which the velocity fields computed in training.
        device: Where it was trained, in words.
        progress: Called with the number of conditions done.

    Raises:
        ValueError: If the bank asks for more conditions than there are, or the policy does not fit them.
    """
    if bank.conditions is not None and bank.conditions > len(conditions):
        raise ValueError(
            f"bank {evaluation.bank} asks for {bank.conditions} conditions, dataset {evaluation.run.dataset} has "
            f"{len(conditions)}: record it with more, or ask for fewer"
        )
    protocol = EvaluationProtocol(
        pairs=bank.pairs,
        nfes=tuple(bank.nfes),
        taus=tuple(bank.taus),
        seed=bank.seed,
        coupling=evaluation.run.coupling,
    )
    gate = evaluate(sampler, conditions[: bank.conditions], protocol, evaluation.label, progress=progress)
    return write_study_gate(
        gate, evaluation, bank, folder, training_data=training_data, precision=precision, device=device
    )


def write_study_gate(
    gate: Gate,
    evaluation: StudyEvaluation,
    bank: Bank,
    folder: str | Path,
    *,
    training_data: str,
    precision: str,
    device: str,
) -> Gate:
    """Write an evaluated gate as a study's: with the run behind it, rounded and compressed.

    Gates of checkpoints on the way keep no residuals.

    Returns:
        The gate as it was written.
    """
    run: dict[str, Any] = {
        "name": evaluation.run.training_name,
        "training_data": training_data,
        "precision": precision,
        "device": device,
    }
    gate.provenance["run"] = run
    finished = evaluation.step == evaluation.run.steps
    compact = compact_gate(gate, residuals=bank.residuals and finished)
    write_gate(compact, Path(folder) / evaluation.gate_file)
    return compact
