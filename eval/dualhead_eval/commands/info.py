"""``dualhead info``: versions, environments, and everything that is chosen by name."""

from __future__ import annotations

import argparse
import json
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

from dualhead_eval.commands.console import open_console

if TYPE_CHECKING:
    from rich.table import Table

DESCRIPTION = "Print versions, environments and registered types; with --json for an issue or a script."
#: Distributions that decide what a run does.
PACKAGES = (
    "lerobot_policy_dualhead",
    "lerobot",
    "torch",
    "gymnasium",
    "mujoco",
    "robosuite",
    "numpy",
    "scipy",
    "scikit-learn",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead info``."""
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")


def run(args: argparse.Namespace) -> int:
    """Print what is installed and registered."""
    from dualhead_policy.quiet import quiet_libraries

    quiet_libraries()
    found = collect()
    if args.json:
        print(json.dumps(found, indent=2))
    else:
        open_console().print(_table(found))
    return 0


def collect() -> dict[str, dict[str, Any]]:
    """Names and what they stand for, by section."""
    import torch
    from lerobot.configs import PreTrainedConfig
    from lerobot.envs import EnvConfig

    import lerobot_policy_dualhead  # noqa: F401  (what LeRobot imports to find our types)
    from dualhead_envs.bypass.perturbations.perturbation import KINDS
    from dualhead_envs.bypass.rendering import opengl
    from dualhead_envs.registration import ENVIRONMENTS
    from dualhead_eval.monitor.signals.registry import SIGNALS
    from dualhead_eval.monitor.thresholds.registry import THRESHOLDS
    from dualhead_eval.partitions.partition_file import KINDS as PARTITIONS
    from dualhead_policy.training.presets import PRESETS

    cuda = torch.cuda.get_device_name(0) if torch.cuda.is_available() else "none: everything runs on the CPU"
    return {
        "versions": {
            **{name: _version(name) for name in PACKAGES},
            "python": platform.python_version(),
            "system": f"{platform.system()} {platform.machine()}",
            "cuda": cuda,
            "pictures": opengl(),
        },
        "environments": {name: arguments["max_episode_steps"] for name, arguments in ENVIRONMENTS.items()},
        "types": {
            "--policy.type": _of_ours(PreTrainedConfig),
            "--env.type": _of_ours(EnvConfig),
            "--partition": list(PARTITIONS),
            "--perturb": list(KINDS),
            "--preset": list(PRESETS),
            "monitor --signals": list(SIGNALS),
            "monitor --threshold": list(THRESHOLDS),
        },
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _of_ours(registry: Any) -> list[str]:
    """Names in one of LeRobot's registries whose classes are of this package."""
    choices: Mapping[str, type] = registry.get_known_choices()
    return sorted(name for name, kind in choices.items() if kind.__module__.startswith("dualhead_"))


def _table(found: Mapping[str, Mapping[str, Any]]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in found["versions"].items():
        table.add_row(name, value)
    table.add_section()
    for name, steps in found["environments"].items():
        table.add_row(f"dualhead_envs:{name}", f"{steps} steps at most")
    table.add_section()
    for flag, names in found["types"].items():
        table.add_row(flag, ", ".join(names))
    return table
