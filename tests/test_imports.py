"""The house's one-way street: who may import whom, and what an import may cost."""

import ast
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
MAY_IMPORT = {
    "dualhead_envs": set(),
    "dualhead_policy": {"dualhead_envs"},
    "dualhead_eval": {"dualhead_envs", "dualhead_policy"},
}
MODULES = [(package, path) for package, folder in FOLDERS.items() for path in sorted(folder.rglob("*.py"))]


def imported_packages(path):
    """Top-level names of everything that a module imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add(node.module or "" if node.level == 0 else path.parent.name)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            # Entry points and lazily imported modules are written as strings.
            head = node.value.partition(":")[0]
            if head.partition(".")[0] in FOLDERS and all(part.isidentifier() for part in head.split(".")):
                names.add(head)
    return {name.partition(".")[0] for name in names}


@pytest.mark.parametrize(("package", "path"), MODULES, ids=lambda value: getattr(value, "stem", value))
def test_imports_run_one_way(package, path):
    ours = imported_packages(path) & FOLDERS.keys() - {package}
    assert ours <= MAY_IMPORT[package], f"{path} imports {sorted(ours - MAY_IMPORT[package])}"


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
    long = {str(path): len(path.read_text().splitlines()) for _, path in MODULES}
    assert not {path: lines for path, lines in long.items() if lines > 400}
