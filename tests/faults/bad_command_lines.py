"""Bad command lines and configuration files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from cases import Case, Products
from damage import CONTROL


def command_line_cases(products: Products) -> Iterator[Case]:
    data, run = str(products.data / "test"), str(products.run)
    train = ["train", f"--dataset.root={products.data / 'train'}", "--output_dir=new", "--policy.device=cpu"]
    exact = ["evaluate", "--exact", "--dataset", data, "--output", "out.json"]
    policy = ["evaluate", "--policy", run, "--dataset", data, "--output", "out.json"]
    ensemble = ["ensemble", run, run, "--dataset", data, "--output", "out"]
    gate = ["report", str(products.gate)]
    for arguments, mentioned in [
        *[([*train, f"--policy.{name}={value}"], name) for name, value in POLICY_FLAGS],
        ([*train, "--policy.kinematic_map=file:nowhere.urdf#tip"], "nowhere.urdf"),
        *[([*train, flag], word) for flag, word in TRAIN_FLAGS],
        *[([*exact, *flags], word) for *flags, word in EVALUATE_FLAGS],
        *[([*policy, *flags], word) for *flags, word in POLICY_EVALUATE_FLAGS],
        *[([*ensemble, *flags], word) for *flags, word in ENSEMBLE_FLAGS],
        *[([*gate, *flags], word) for *flags, word in REPORT_FLAGS],
        *[(["record", *flags], word) for *flags, word in RECORD_FLAGS],
        *[(list(arguments), word) for *arguments, word in OTHERS],
    ]:
        shown = " ".join(argument for argument in arguments if "/" not in argument)
        yield Case(f"command: {shown[:100]!a}", lambda folder, arguments=arguments: arguments, (mentioned,))
    for what, (text, word) in YAML_FILES.items():

        def prepare(folder: Path, text: str = text) -> list[str]:
            (folder / "bad.yaml").write_text(text)
            return [*train, f"--config_path={folder / 'bad.yaml'}"]

        yield Case(f"yaml: {what}", prepare, (word, "bad.yaml"))

        def study(folder: Path, text: str = text) -> list[str]:
            (folder / "bad.yaml").write_text(text)
            return ["study", str(folder / "bad.yaml")]

        yield Case(f"study: {what}", study, (word, "bad.yaml"))


POLICY_FLAGS = [
    ("chunk_size", "0"), ("chunk_size", "many"), ("chunk_size", "1000000000"), ("velocity_width", "1000000000"),
    ("velocity_layers", "-1"), ("velocity_layers", "1.5"), ("token", "telepathy"), ("n_tokens", "2"),
    ("kl_weight", "nan"), ("kl_weight", "inf"), ("consistency_weight", "-1"), ("source_noise_beta", "2"),
    ("latent", "mind"), ("free_bits", "1"), ("observation_noise", "-1"), ("optimizer_lr", "0"), ("optimizer_lr", "nan"),
    ("optimizer_lr", "fast"), ("optimizer_betas", "[2,3]"), ("lr_schedule", "random"), ("lr_warmup_steps", "-1"),
    ("kinematic_map", "elbow"), ("rotation_head", "true"),
    ("normalization_mapping", "{'STATE': 'MAGIC'}"), ("seed", "-1"), ("device", "toaster"), ("colour", "red"),
    ("time_frequencies", "1000000"), ("action_std_floor", "0"), ("n_action_steps", "99"), ("padded_steps", "99"),
    ("num_inference_steps", "0"), ("token_draw", "never"), ("latent_dim", "-3"), ("optimizer_grad_clip_norm", "-1"),
]  # fmt: skip
TRAIN_FLAGS = [
    ("--steps=0", "steps"), ("--steps=-5", "steps"), ("--steps=many", "steps"), ("--batch_size=0", "batch_size"),
    ("--batch_size=-1", "batch_size"), ("--save_freq=0", "save_freq"), ("--save_freq=-1", "save_freq"),
    ("--colour=red", "colour"), ("--seed=-1", "seed"), ("--seed=word", "seed"), ("--policy.type=act", "act"),
    ("--dataset.episodes=[0]", "episodes"), ("--dataset.streaming=true", "streaming"),
    ("--policy.path=nowhere", "nowhere"),
    ("--dataset.root=", "root"), ("--preset", "preset"),
    ("--config_path=nowhere.yaml", "nowhere"),
]  # fmt: skip
EVALUATE_FLAGS = [
    ("--pairs", "0", "pairs"), ("--pairs", "-1", "pairs"), ("--pairs", "many", "pairs"), ("--nfe", "0", "nfe"),
    ("--nfe", "-3", "nfe"), ("--tau", "nan", "tau"), ("--tau", "-1", "tau"), ("--tau", "inf", "tau"),
    ("--conditions", "0", "conditions"), ("--conditions", "999", "conditions"), ("--seed", "-1", "seed"),
    ("--token-replacement-prob", "2", "token"), ("--token-replacement-prob", "nan", "token"), ("--label", "", "label"),
    ("--label", CONTROL, "label"), ("--label", "x" * 999, "label"), ("--source-noise-beta", "nan", "beta"),
    ("--source-noise-beta", "7", "beta"), ("--episodes", "3", "episodes"), ("--dataset", "", "dataset"),
    ("--dataset", "nowhere", "nowhere"), ("--colour", "colour"),
]  # fmt: skip
POLICY_EVALUATE_FLAGS = [
    ("--policy", "nowhere", "nowhere"), ("--policy", "", "policy"), ("--control", "pose", "control"),
    ("--record", "loop", "--episodes", "0", "episodes"), ("--record", "loop", "--samples", "0", "samples"),
    ("--record", "loop", "--control", "pose", "pose"), ("--record", "loop", "--seed", "-1", "seed"),
    ("--rollouts", "x", "rollouts"),
]  # fmt: skip
ENSEMBLE_FLAGS = [
    ("--pairs", "0", "pairs"), ("--vfd-pairs", "0", "pairs"), ("--vfd-pairs", "many", "vfd-pairs"),
    ("--nfe", "0", "nfe"), ("--seed", "-1", "seed"), ("--head", "elbow", "head"), ("--label", "", "label"),
    ("--conditions", "1", "same checkpoint"), ("--colour", "colour"),
]  # fmt: skip
REPORT_FLAGS = [
    ("--tau", "0.123", "tau"), ("--nfe", "3", "nfe"), ("--tau", "nan", "tau"), ("nowhere.json", "nowhere"),
    ("--json", "", "json"), ("--figure", "", "figure"), ("--colour", "colour"),
    ("--json", "/dev/null/x.json", "x.json"),
]  # fmt: skip
RECORD_FLAGS = [
    ("--env", "elbow", "--root", "r", "elbow"), ("--env", "RotatingRing-v77", "--root", "r", "RotatingRing-v77"),
    ("--root", "", "root"),
    ("--root", "r", "--episodes", "0", "episodes"), ("--root", "r", "--episodes", "-3", "episodes"),
    ("--root", "r", "--conditions", "0", "conditions"), ("--root", "r", "--seed", "-1", "seed"),
    ("--root", "r", "--representation", "elbow", "elbow"), ("--root", "r", "--colour", "colour"),
    ("--env", "v2", "--root", "r", "--pairs", "0", "pairs"),
    ("--env", "v2", "--root", "r", "--workers", "0", "workers"),
    ("--env", "v2", "--root", "r", "--episodes", "3", "episodes"), ("--root", "/dev/null/r", "/dev/null"),
    ("--env", "v2", "--root", "r", "--ways", "4", "ways"), ("--env", "v2", "--root", "r", "--ways", "x", "ways"),
    ("--env", "v3", "--root", "r", "--ways", "3", "ways"), ("--root", "r", "--ways", "3", "ways"),
    ("--env", "v3", "--root", "r", "--amplitude", "0.1", "amplitude"),
    ("--env", "v2", "--root", "r", "--amplitude", "0.1", "obstacle"),
    ("--env", "v2", "--root", "r", "--obstacle", "beam", "beam"),
]  # fmt: skip
OTHERS = [
    ("report", "", "empty"), ("train", "--output_dir=x", "dataset.root"), ("evaluate", "--output"), ("report", "GATE"),
    ("train", "--resume=true", "output_dir"), ("train", "--resume=true", "--output_dir=nowhere", "nowhere"),
    ("demo", "--env", "elbow", "elbow"), ("demo", "--colour", "colour"), ("dance", "dance"),
    ("study", "astrology", "astrology"), ("study", "nowhere.yaml", "nowhere"),
    ("study", "x.yaml", "--jobs", "0", "jobs"),
    ("ensemble", "--output"), ("ensemble", "nowhere", "nowhere", "--dataset", "x", "--output", "y", "nowhere"),
    ("ensemble", "a", "--dataset", "x", "--output", "y", "member"),
]  # fmt: skip
YAML_FILES = {
    "no mapping": ("- 1\n- 2\n", "bad.yaml"),
    "no YAML": ("a: [1, 2\nb: }", "bad.yaml"),
    "an object of Python": ("steps: !!python/object/apply:os.system ['touch it-ran']\n", "bad.yaml"),
    "an unknown field": ("policy: {type: dualhead, colour: red}\n", "colour"),
    "an unknown policy": ("policy: {type: elbow}\n", "elbow"),
    "a width of words": ("policy: {type: dualhead, velocity_width: wide}\n", "velocity_width"),
    "a width without end": ("policy: {type: dualhead, velocity_width: 1000000000}\n", "velocity_width"),
    "a bomb of aliases": (
        "a: &a [x, x, x, x, x, x, x, x, x]\n"
        + "".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)),
        "bad.yaml",
    ),
    "nested without end": ("[" * 20_000, "bad.yaml"),
    "a control code": ("steps: \x1b[2J\n", "bad.yaml"),
    "bytes of no text": ("\x00\x01", "bad.yaml"),
    "steps of words": ("steps: many\n", "steps"),
}
