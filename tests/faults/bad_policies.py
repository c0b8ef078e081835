"""Bad policies' folders and training runs: configurations, processors, tensors, training states, logs, statistics."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from cases import Case, Products, tree_case
from damage import Damage, binary_damages, byte_damages, edited, json_damages
from safetensors.torch import load_file, save_file

from dualhead_policy.training.checkpoints import last_checkpoint


def _evaluated(products: Products, folder: Path) -> list[str]:
    """The command that evaluates a policy's folder."""
    output = str(folder.parent / "out.gate.json")
    data = ["--dataset", str(products.data / "test"), "--pairs", "2", "--conditions", "1"]
    return ["evaluate", "--policy", str(folder), *data, "--output", output]


def policy_cases(products: Products) -> Iterator[Case]:
    rng = np.random.default_rng(4)
    checkpoint = last_checkpoint(products.run)
    assert checkpoint is not None
    whole = checkpoint / "pretrained_model"

    evaluated = partial(_evaluated, products)
    for file, (free, most) in POLICY_DOCUMENTS.items():
        text = (whole / file).read_text()
        for what, damage in byte_damages(len(text), rng):
            yield tree_case(f"{file}: {what}", whole, file, damage, evaluated)
        for what, change in json_damages(json.loads(text), rng, free=free, closed=file != "config.json", most=most):
            yield tree_case(f"{file}: {what}", whole, file, edited(change), evaluated, "policy.", "layout", "input")
    for file in ("model.safetensors", NORMALIZER):
        for what, damage in binary_damages((whole / file).stat().st_size, rng):
            yield tree_case(f"{file}: {what}", whole, file, damage, evaluated)
        for what, tensor_change in TENSORS.items():
            yield tree_case(f"{file}: {what}", whole, file, _retensored(tensor_change), evaluated)
        yield tree_case(f"{file}: a link elsewhere", whole, file, _linked, evaluated)
        yield tree_case(f"{file}: missing", whole, file, Path.unlink, evaluated)
    for what, value in SIZES.items():
        field_name = what.split(" ")[0]
        yield tree_case(
            f"config.json: {what}", whole, "config.json",
            edited(lambda config, name=field_name, value=value: config.update({name: value})), evaluated, field_name,
        )  # fmt: skip
    for what, step in FOREIGN_STEPS.items():
        yield tree_case(
            f"policy_preprocessor.json: {what}", whole, "policy_preprocessor.json",
            edited(lambda content, step=step: content["steps"].append(step)), evaluated,
        )  # fmt: skip


def lerobot_policy_cases(products: Products) -> Iterator[Case]:
    """The folder of a policy of another LeRobot type."""
    rng = np.random.default_rng(6)
    checkpoint = last_checkpoint(products.act)
    assert checkpoint is not None
    whole = checkpoint / "pretrained_model"

    evaluated = partial(_evaluated, products)
    for file, (free, most) in ACT_DOCUMENTS.items():
        text = (whole / file).read_text()
        for what, damage in byte_damages(len(text), rng):
            yield tree_case(f"act {file}: {what}", whole, file, damage, evaluated, "policy")
        for what, change in json_damages(json.loads(text), rng, free=free, closed=file != "config.json", most=most):
            yield tree_case(
                f"act {file}: {what}", whole, file, edited(change), evaluated, "policy", "model.safetensors"
            )
    for file in ("model.safetensors", NORMALIZER):
        for what, damage in binary_damages((whole / file).stat().st_size, rng):
            yield tree_case(f"act {file}: {what}", whole, file, damage, evaluated)
    for what, tensor_change in TENSORS.items():
        file = "model.safetensors"
        yield tree_case(f"act {file}: {what}", whole, file, _retensored(tensor_change), evaluated)
    for what, step in FOREIGN_STEPS.items():
        # Another pipeline than our own policies' may repeat a step.
        if what != "a fifth step":
            yield tree_case(
                f"act policy_preprocessor.json: {what}", whole, "policy_preprocessor.json",
                edited(lambda content, step=step: content["steps"].append(step)), evaluated,
            )  # fmt: skip


#: What may be open in an ACT's folder: what LeRobot keeps for uploads, and what opening it replaces.
_OPEN = ("device", "pretrained_path", "push_to_hub", "pretrained_backbone_weights")
#: An integer of LeRobot's that it writes as false.
_OPEN += ("replace_final_stride_with_dilation",)
ACT_DOCUMENTS: dict[str, tuple[tuple[str, ...], int]] = {
    "config.json": (_OPEN, 60),
    "policy_preprocessor.json": (("name", "steps.2.config.device", "steps.2.config.float_dtype"), 20),
    "policy_postprocessor.json": (
        # Only actions are brought back to their units: how observations were normalised does not matter there.
        ("name", "steps.1.config.device", "steps.1.config.float_dtype", "steps.0.config.norm_map"),
        15,
    ),
}
NORMALIZER = "policy_preprocessor_step_3_normalizer_processor.safetensors"
POLICY_DOCUMENTS: dict[str, tuple[tuple[str, ...], int]] = {
    # What LeRobot keeps for uploads, and what this package replaces or may be left open.
    "config.json": (
        ("device", "pretrained_path", "pretrained_revision", "repo_id", "private", "tags", "license", "use_peft"),
        60,
    ),
    "policy_preprocessor.json": (("steps.2.config.device", "steps.2.config.float_dtype"), 40),
    "policy_postprocessor.json": (("steps.1.config.device", "steps.1.config.float_dtype"), 25),
}
TENSORS: dict[str, Callable[[dict[str, Any]], None]] = {
    "a tensor less": lambda tensors: tensors.pop(next(iter(tensors))) is None,
    "a tensor of another shape": lambda tensors: tensors.update({next(iter(tensors)): _first(tensors).new_zeros(3, 5)}),
    "not a number": lambda tensors: _first_float(tensors).fill_(float("nan")) is None,
    "infinite": lambda tensors: _first_float(tensors).fill_(float("inf")) is None,
    "integers": lambda tensors: tensors.update({_float_name(tensors): _first_float(tensors).long()}),
}
SIZES = {
    "velocity_width without end": 10**9,
    "velocity_layers without end": 10**6,
    "encoder_dim without end": 10**9,
    "chunk_size without end": 10**9,
    "time_frequencies without end": 10**9,
    "latent_dim without end": 10**9,
    "num_inference_steps without end": 10**12,
    "velocity_width of no integer": 64.5,
    "velocity_width of zero": 0,
    "n_tokens of one": 1,
    "token of another kind": "telepathy",
    "observation_noise below zero": -1.0,
    "source_noise_beta beyond one": 2.0,
}
FOREIGN_STEPS: dict[str, dict[str, Any]] = {
    "a program": {"class": "subprocess.Popen", "config": {"args": ["touch", "it-ran"]}},
    "a function": {"class": "os.system", "config": {"command": "touch it-ran"}},
    "another registered step": {"registry_name": "tokenizer_processor", "config": {"tokenizer_name": "x/y"}},
    "a fifth step": {"registry_name": "to_batch_processor", "config": {}},
}


def _first(tensors: dict[str, Any]) -> Any:
    return next(iter(tensors.values()))


def _float_name(tensors: dict[str, Any]) -> str:
    # The observations' range may be infinite before it is fitted; weights and deviations never are.
    return next(name for name, values in tensors.items() if values.is_floating_point() and "range" not in name)


def _first_float(tensors: dict[str, Any]) -> Any:
    return tensors[_float_name(tensors)]


def _retensored(change: Callable[[dict[str, Any]], Any]) -> Damage:
    def apply(path: Path) -> None:
        tensors = load_file(path)
        change(tensors)
        save_file(tensors, path)

    return apply


def _linked(path: Path) -> None:
    elsewhere = path.parent.parent / "elsewhere"
    path.rename(elsewhere)
    path.symlink_to(elsewhere)


def run_cases(products: Products) -> Iterator[Case]:
    rng = np.random.default_rng(5)
    checkpoint = last_checkpoint(products.run)
    assert checkpoint is not None
    inside = checkpoint.relative_to(products.run.resolve())

    def resumed(folder: Path) -> list[str]:
        return ["train", "--resume=true", f"--output_dir={folder}", "--steps=31"]

    def trained(folder: Path) -> list[str]:
        small = ["--steps=1", "--batch_size=8", "--policy.velocity_width=16", "--policy.encoder_dim=8"]
        output = f"--output_dir={folder.parent / 'run'}"
        return ["train", f"--dataset.root={folder}", output, "--policy.device=cpu", *small]

    log = "training_log.jsonl"
    for what, line in LOG_LINES.items():
        damage: Damage = lambda path, line=line: path.write_text(path.read_text() + line + "\n") and None  # noqa: E731
        yield tree_case(f"log: {what}", products.run, log, damage, resumed)
    for file in ("training_step.json", "optimizer_param_groups.json", "window_source.json"):
        path = str(inside / "training_state" / file)
        for what, damage in byte_damages((products.run / path).stat().st_size, rng):
            yield tree_case(f"{file}: {what}", products.run, path, damage, resumed, "training_state")
    for file in ("optimizer_state.safetensors", "rng_state.safetensors"):
        path = str(inside / "training_state" / file)
        for what, damage in binary_damages((products.run / path).stat().st_size, rng):
            yield tree_case(f"{file}: {what}", products.run, path, damage, resumed, "training_state")
    path = str(inside / "pretrained_model" / "train_config.json")
    for what, damage in byte_damages((products.run / path).stat().st_size, rng):
        yield tree_case(f"train_config.json: {what}", products.run, path, damage, resumed)
    split = products.data / "train"
    for what, damage in byte_damages((split / "meta/stats.json").stat().st_size, rng):
        yield tree_case(f"meta/stats.json: {what}", split, "meta/stats.json", damage, trained)
    statistics = json.loads((split / "meta/stats.json").read_text())
    used = {key: statistics[key] for key in ("action", "observation.state", "observation.environment_state")}
    used = {key: {name: used[key][name] for name in ("mean", "std", "min", "max")} for key in used}
    for what, change in json_damages(used, rng, most=30):
        if "stranger" not in what:
            yield tree_case(f"meta/stats.json: {what}", split, "meta/stats.json", edited(change), trained)
    for file in ("meta/tasks.parquet", "meta/episodes/chunk-000/file-000.parquet"):
        for what, damage in list(binary_damages((split / file).stat().st_size, rng))[:4]:
            yield tree_case(f"{file}: {what}", split, file, damage, trained, "meta")


LOG_LINES = {
    "a word": "word",
    "half a line": '{"step": 999, "lo',
    "not a number": '{"step": 999, "loss": NaN}',
    "no step": '{"loss": 1.0}',
    "a step of words": '{"step": "many", "loss": 1.0}',
    "an earlier step": '{"step": 1, "loss": 1.0}',
    "a list": "[1, 2]",
    "nested without end": "[" * 100_000,
    "a byte of no text": "\x00",
    "a number beyond numbers": '{"step": 999, "loss": 1e999}',
}
