"""Whether a file of results is what a study asks for: configuration, training, conditions and protocol.

A study knows its results by their content, not by who made them: a gate that another machine wrote is taken, one of
another configuration, budget, partition or protocol is refused, whatever its name.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from dualhead_eval.evaluation.protocol import described_coupling
from dualhead_eval.gate import Gate
from dualhead_eval.gate.gate import DRAWS
from dualhead_eval.studies.study_file import Bank, StudyDataset
from dualhead_eval.studies.study_plan import StudyEvaluation, StudyLoop, StudyRun

#: Fields of a policy's configuration that say nothing of what it is, or that its data fill in.
NO_IDENTITY = (
    "device", "pretrained_path", "seed", "input_features", "output_features", "representation", "dataset_name",
    "environment", "token_nmi", "repo_id", "tags", "private", "license", "push_to_hub",
)  # fmt: skip
#: What a policy was before it had the field, where that is not the field's default.
BEFORE_THE_FIELD = {"embedding_gain": 1.0}
#: What a configuration may leave open until it meets its data.
OPEN_VALUES = (None, "auto")
#: Mechanisms, whose None is none and nothing that data fill in.
NEVER_OPEN = ("token", "latent", "source_noise_alignment")
#: What the flags of a policy begin with.
POLICY = "policy."
BATCH = "batch_size"
#: Batch of a run whose configuration does not say: that of every preset.
DEFAULT_BATCH = 128


def wanted_policy(run: StudyRun) -> dict[str, Any]:
    """The policy's configuration that a run asks for, every field of it, and its batch size.

    Raises:
        FileNotFoundError: If there is no such configuration file.
        ValueError: If the configuration file is not a mapping, or names a field that the policy does not have.
    """
    file: dict[str, Any] = {}
    if run.config is not None:
        if not Path(run.config).is_file():
            raise FileNotFoundError(
                f"configuration {run.config} does not exist in {Path.cwd()}, where the command is given: give it in "
                "the folder that the study's configurations are relative to"
            )
        file = yaml.safe_load(Path(run.config).read_text(encoding="utf-8"))
        if not isinstance(file, dict) or not isinstance(file.get("policy"), dict):
            raise ValueError(
                f"{run.config} holds no policy, expected a configuration of `dualhead train`: give another"
            )
    flags = {name.removeprefix(POLICY): value for name, value in run.flags.items() if name.startswith(POLICY)}
    policy = {name: value for name, value in file.get("policy", {}).items() if name != "type"} | flags
    defaults = _defaults()
    if unknown := sorted(policy.keys() - defaults.keys()):
        raise ValueError(
            f"configuration {run.configuration} names policy.{unknown[0]}, which no policy has: correct it"
        )
    return defaults | policy | {BATCH: run.flags.get(BATCH, file.get(BATCH, DEFAULT_BATCH))}


def refuse_other_evaluation(
    gate: Gate,
    evaluation: StudyEvaluation,
    bank: Bank,
    dataset: StudyDataset,
    policy: Mapping[str, Any],
    *,
    source: object,
) -> None:
    """Refuse a gate that is not the evaluation asked for.

    Args:
        gate: What was found.
        evaluation, bank, dataset: What was asked for.
        policy: Of :func:`wanted_policy`.
        source: Its file, for the error.

    Raises:
        ValueError: In one sentence that names the first difference.
    """
    for what, found, wanted in _differences(gate, evaluation, bank, dataset, policy):
        raise ValueError(_refusal(source, what, found, wanted))


def _differences(
    gate: Gate, evaluation: StudyEvaluation, bank: Bank, dataset: StudyDataset, policy: Mapping[str, Any]
) -> Iterator[tuple[str, Any, Any]]:
    """(what, found, wanted) of everything in which a gate differs."""
    provenance, run = gate.provenance, evaluation.run
    expected: list[tuple[str, Any, Any]] = [
        ("method", provenance.get("method"), "policy" if run.draws is None else DRAWS),
        ("head", provenance.get("head"), run.draws),
        *_training(provenance, run, evaluation.step, policy),
        ("pairs_per_condition", provenance.get("pairs_per_condition"), bank.pairs),
        ("evaluation seed", provenance.get("seed"), bank.seed),
        ("coupling", provenance.get("coupling"), described_coupling(run.coupling)),
        ("nfes", gate.nfes, sorted(bank.nfes)),
        ("reference_nfe", gate.reference_nfe, bank.nfes[0]),
        ("taus", gate.taus, sorted({gate.reference_tau, *bank.taus})),
    ]
    if bank.conditions is not None:
        expected.append(("conditions", gate.n_conditions, bank.conditions))
    recorded = provenance.get("dataset") or {}
    expected += [("environment", recorded.get("env_id"), dataset.env), ("split", recorded.get("split"), "test")]
    env_kwargs = recorded.get("env_kwargs") or {}
    expected += [(f"environment's {name}", env_kwargs.get(name), value) for name, value in dataset.env_kwargs.items()]
    yield from (line for line in expected if line[1] != line[2])
    yield from _policy_differences(provenance.get("config") or {}, policy)


def refuse_other_loop(
    sidecar: Mapping[str, Any], loop: StudyLoop, dataset: StudyDataset, policy: Mapping[str, Any], *, source: object
) -> None:
    """Refuse outcomes that are not those of the closed loop asked for.

    Args:
        sidecar: The recording's description, checked.
        loop, dataset: What was asked for.
        policy: Of :func:`wanted_policy`.
        source: Its file, for the error.

    Raises:
        ValueError: In one sentence that names the first difference.
    """
    provenance, given = sidecar.get("policy") or {}, sidecar["env_kwargs"]
    wanted_kwargs = dataset.env_kwargs | {"control": loop.control}
    # A description holds every seed once.
    seeds = [outcome["seed"] for outcome in sidecar["outcomes"]]
    lines = [
        *_training(provenance, loop.run, loop.run.steps, policy),
        ("environment", sidecar["env_id"], dataset.env),
        *((f"environment's {name}", given.get(name), value) for name, value in wanted_kwargs.items()),
        ("perturbation", given.get("perturbation"), None),
        ("coupling", provenance.get("coupling"), None),
        ("number of episodes", len(seeds), loop.episodes),
        ("first episode's seed", min(seeds), loop.first_seed),
        ("last episode's seed", max(seeds), loop.first_seed + loop.episodes - 1),
    ]
    different = [line for line in lines if line[1] != line[2]]
    for what, found, wanted in itertools.chain(different, _policy_differences(provenance.get("config") or {}, policy)):
        raise ValueError(_refusal(source, what, found, wanted))


def _refusal(source: object, what: str, found: Any, wanted: Any) -> str:
    return (
        f"{source} is not what the study asks for: it has {what} {found!r}, expected {wanted!r}; move it away, or "
        "give the study another --results"
    )


def _training(
    provenance: Mapping[str, Any], run: StudyRun, step: int, policy: Mapping[str, Any]
) -> list[tuple[str, Any, Any]]:
    """(what, found, wanted) of the training behind a file of results."""
    training = provenance.get("training") or {}
    return [
        ("training_step", provenance.get("training_step"), step),
        ("training steps", training.get("steps"), run.steps),
        ("training seed", training.get("seed"), run.seed),
        (BATCH, training.get(BATCH), policy[BATCH]),
        ("fresh_paths", training.get("fresh_paths"), False),
    ]


def _policy_differences(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    """(what, found, wanted) of the fields in which a policy is another.

    A field that is younger than the file counts as what it was before.
    """
    defaults = _defaults()
    for name, value in wanted.items():
        if name in NO_IDENTITY or name not in defaults:
            continue
        own = found.get(name, BEFORE_THE_FIELD.get(name, defaults[name]))
        if value in OPEN_VALUES and name not in NEVER_OPEN:
            # What the data fill in is never the value that switches it off.
            if value == "auto" and own == "none":
                yield f"policy.{name}", own, value
            continue
        if _plain(own) != _plain(value):
            yield f"policy.{name}", own, value


@cache
def _defaults() -> dict[str, Any]:
    from dualhead_policy.configuration_dualhead import DualheadConfig

    # What a factory makes (the normalisation of observations) is never a study's subject.
    return {field.name: field.default for field in fields(DualheadConfig) if field.default is not MISSING}


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
