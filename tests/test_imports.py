"""The house's one-way street: who may import whom, and what an import may cost."""

import ast
import graphlib
import statistics
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = {
    "dualhead_envs": ROOT / "dualhead_envs",
    "dualhead_policy": ROOT / "dualhead_policy",
    "dualhead_eval": ROOT / "eval" / "dualhead_eval",
}
#: The rooms of each package, in the order of the pipeline: a module imports its own room and those above it.
ROOMS = {
    "dualhead_envs": [
        "atomic_files", "validated_json", "validated_yaml", "worker_processes", "space_tables", "ribbon", "layout",
        "dataset_sidecar", "dataset_columns", "dataset_frames", "recorded_environment", "registration",
        "lerobot_config", "recording", "ring", "bypass", "lerobot_envs", "record", "record_command",
    ],
    "dualhead_policy": [
        "quiet", "hub_folder", "representation", "sampling", "checkpoint_loading", "kinematics",
        "configuration_checks", "configuration_dualhead", "processor_dualhead", "disagreement_step", "decision_hooks",
        "processor_loading", "model_card", "model", "flow", "fitting", "modeling_dualhead", "lerobot_policies",
        "pretrained", "training",
    ],
    "dualhead_eval": [
        "atomic_text", "exact_reference", "penalised_reference", "effects", "residuals", "gate", "statistics",
        "certificate", "paper", "partitions", "certificate_step", "evaluation", "ensembles", "monitor", "report",
        "studies", "results_page", "commands", "cli", "__main__",
    ],
}  # fmt: skip
#: Every package imports itself and those before it.
PACKAGES = list(ROOMS)


def module_names():
    """Every module by its dotted name; a package by its folder's."""
    for package, folder in FOLDERS.items():
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            yield ".".join([package, *(part for part in parts if part != "__init__")]), path


MODULES = dict(module_names())


def imported_modules(path):
    """Our modules that a module imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                names.add(inner if inner in MODULES else node.module or "")
    return names & MODULES.keys()


def named_packages(path):
    """Our packages that a module names in a string: entry points and what is imported when it is needed."""
    strings = {n.value for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Constant)}
    return {
        text.partition(":")[0].partition(".")[0]
        for text in strings
        if isinstance(text, str) and text.partition(":")[0] in MODULES
    }


def place(module):
    """Where a module stands in the pipeline: its package, and its room in there (the package itself stands last)."""
    package, _, rest = module.partition(".")
    rooms = ROOMS[package]
    return PACKAGES.index(package), rooms.index(rest.partition(".")[0]) if rest else len(rooms)


@pytest.mark.parametrize("module", MODULES)
def test_imports_run_one_way(module):
    later = sorted(other for other in imported_modules(MODULES[module]) if place(other) > place(module))
    # A package's own name stands for what it offers its users, who may be its command line.
    later = [other for other in later if other != module.partition(".")[0]]
    assert not later, f"{module} imports {later}, which come after it: see ROOMS"
    ours = PACKAGES.index(module.partition(".")[0])
    assert all(PACKAGES.index(package) <= ours for package in named_packages(MODULES[module]))


def test_no_import_circle():
    graph = {module: imported_modules(path) - FOLDERS.keys() - {module} for module, path in MODULES.items()}
    list(graphlib.TopologicalSorter(graph).static_order())


def modules_after(statement):
    code = f"{statement}\nimport sys\nprint(' '.join({{name.partition('.')[0] for name in sys.modules}}))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stderr == ""
    return set(answer.stdout.split())


@pytest.mark.parametrize(
    "statement",
    [
        "import dualhead_envs",
        "import gymnasium; gymnasium.make('dualhead_envs:RotatingRing-v4').reset()",
        "import dualhead_envs.record_command",
    ],
)
def test_environments_are_light_to_import(statement):
    heavy = {"torch", "lerobot", "mujoco", "robosuite", "pandas", "pyarrow", "matplotlib"}
    assert not modules_after(statement) & heavy


def test_files_stay_small():
    lengths = {module: len(path.read_text().splitlines()) for module, path in MODULES.items()}
    assert not {module: lines for module, lines in lengths.items() if lines > 350}
    assert statistics.median(lengths.values()) < 150
