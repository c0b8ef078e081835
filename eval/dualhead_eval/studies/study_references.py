"""Exact references of a study's cells: the optimum of the same loss under the same conditions.

References are gate files themselves, found by what they hold. On the ring the closed form is sampled where it is
missing and the dataset is at hand; the numerical optimum under consistency takes longer and is taken from the folders
given.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dualhead_eval.gate import Gate, read_gate, write_gate
from dualhead_eval.gate.gate import DRAWS
from dualhead_eval.paper.mechanism import mechanism_of
from dualhead_eval.statistics.run_summary import summarise_run
from dualhead_eval.studies.gate_identity import wanted_policy
from dualhead_eval.studies.study_cells import StudyCell
from dualhead_eval.studies.study_file import Bank
from dualhead_eval.studies.study_plan import StudyPlan

#: Largest difference of two recordings' conditions that count as the same: machines differ in a float32's last bits.
SAME_CONDITION = 1e-5
#: What else a ring's data are made of.
_RING = ("mode_probabilities", "mode_angles", "path_spread")


@dataclass(frozen=True)
class StudyReference:
    """An exact reference beside a cell.

    Attributes:
        rho: Its normalised effect.
        approximate: Whether it is the moment-matched one.
        n_conditions: Conditions behind it; it may have been solved under the first of a cell's conditions only.
    """

    rho: float
    approximate: bool
    n_conditions: int


class StudyReferences:
    """References in some folders.

    Args:
        folders: Folders of gate files; those that do not exist are passed over.

    Raises:
        ValueError: If a gate file is damaged.
    """

    def __init__(self, folders: Iterable[Path]):
        files = [file for folder in folders for file in sorted(folder.rglob("*.gate.json*"))]
        gates = [read_gate(file) for file in files]
        self._by_key: dict[tuple[Any, ...], list[Gate]] = {}
        for gate in gates:
            if mechanism_of(gate).reference:
                self._by_key.setdefault(_key(gate), []).append(gate)

    def find(self, cell: StudyCell) -> StudyReference | None:
        """The reference of a cell's mechanism under most of its conditions, None if there is none."""
        own = cell.runs[0].gate
        if not has_reference(own):
            return None
        found = [gate for gate in self._by_key.get(_key(own), []) if _same_conditions(gate, own)]
        if not found:
            return None
        gate = max(found, key=lambda candidate: candidate.n_conditions)
        approximate = "approximate" in str(gate.provenance.get("method"))
        return StudyReference(summarise_run(gate).rho, approximate, gate.n_conditions)

    def rho(self, cell: StudyCell) -> float | None:
        """rho of a cell's reference, None if there is none."""
        found = self.find(cell)
        return None if found is None else found.rho


def has_reference(gate: Gate) -> bool:
    """Whether two heads' loss has a reference at all: no latent, and no token but the oracle drawn uniformly."""
    if gate.provenance.get("method") == DRAWS:
        return False
    mechanism, config = mechanism_of(gate), gate.provenance.get("config") or {}
    return mechanism.latent is None and (
        mechanism.token is None
        or (mechanism.token == "oracle" and not mechanism.learned_draw and not config.get("token_null_prob"))
    )


def write_missing_references(plan: StudyPlan, data: Path, folder: Path) -> bool:
    """Sample the closed-form references of a plan's ring cells whose dataset is at hand.

    Args:
        plan: What the study asks for, whether or not its runs are there.
        data: Folder of the datasets.
        folder: Folder of the references.

    Returns:
        Whether any was written.
    """
    from dualhead_eval.evaluation.conditions import open_conditions
    from dualhead_eval.evaluation.open_loop import evaluate
    from dualhead_eval.evaluation.protocol import EvaluationProtocol
    from dualhead_eval.evaluation.samplers import open_exact_reference
    from dualhead_eval.gate.compact import compact_gate
    from dualhead_policy.sampling import SamplingCoupling

    wanted: dict[Path, tuple[Path, Bank, dict[str, Any]]] = {}
    for evaluation in plan.evaluations:
        bank, root = plan.bank(evaluation), data / evaluation.run.dataset / "test"
        ring = plan.datasets[evaluation.run.dataset].env.startswith("RotatingRing")
        if evaluation.run.draws or not ring or len(bank.nfes) > 1 or bank.taus or not root.is_dir():
            continue
        policy = wanted_policy(evaluation.run)
        for field in ("source_noise_beta", "token_draw"):
            if (sampled := getattr(evaluation.run.coupling, field)) is not None:
                policy[field] = sampled
        alignment = evaluation.run.coupling.source_noise_alignment
        if (name := _closed_form(policy)) is not None:
            name += "" if alignment is None else f"_{alignment}"
            path = folder / evaluation.run.dataset / f"{name}-{evaluation.bank}.gate.json.gz"
            if not path.exists():
                wanted[path] = root, bank, policy | {"source_noise_alignment": alignment}
    for path, (root, bank, policy) in wanted.items():
        conditions = open_conditions(root)[: bank.conditions]
        options: dict[str, Any] = {}
        if policy["token"]:
            options = {"token": "oracle", "token_replacement_prob": float(policy["token_replacement_prob"])}
        coupling = SamplingCoupling(
            source_noise_beta=float(policy["source_noise_beta"]),
            source_noise_alignment=policy["source_noise_alignment"],
        )
        protocol = EvaluationProtocol(pairs=bank.pairs, seed=bank.seed, coupling=coupling)
        label = f"{path.parent.name} {path.name.partition('-')[0]}"
        reference = evaluate(open_exact_reference(conditions, **options), conditions, protocol, label)
        with suppress(FileExistsError):  # another call was faster, and its gate is the same
            write_gate(compact_gate(reference, residuals=False), path)
    return bool(wanted)


def _closed_form(policy: Mapping[str, Any]) -> str | None:
    """Name of the closed-form optimum of a policy on the ring; None if its loss has none."""
    drawn = policy["token"] == "oracle" and policy["token_draw"] == "uniform" and not policy["token_null_prob"]
    if policy["latent"] or policy["consistency_weight"] or (policy["token"] and not drawn):
        return None
    if policy["token"]:
        return f"exact_oracle_replacement_{float(policy['token_replacement_prob']):g}"
    return f"exact_beta_{float(policy['source_noise_beta']):g}"


def _key(gate: Gate) -> tuple[Any, ...]:
    mechanism = mechanism_of(gate)
    dataset = (gate.provenance.get("dataset") or {}).get("env_kwargs") or {}
    token = (mechanism.token, _replacement(gate)) if mechanism.token else None
    place = (mechanism.environment, mechanism.representation, gate.n_modes, gate.reference_tau, gate.reference_nfe)
    noise = (mechanism.beta, mechanism.alignment)
    return *place, str([dataset.get(name) for name in _RING]), noise, token, mechanism.consistency


def _replacement(gate: Gate) -> float:
    provenance = gate.provenance
    settings = {**provenance, **(provenance.get("config") or {})}
    return float(settings.get("token_replacement_prob") or 0.0)


def _same_conditions(reference: Gate, own: Gate) -> bool:
    """Whether the reference's conditions are the first of the cell's."""
    n = reference.n_conditions
    first = own.conditions[:n]
    return n <= own.n_conditions and bool(np.allclose(reference.conditions, first, rtol=0, atol=SAME_CONDITION))
