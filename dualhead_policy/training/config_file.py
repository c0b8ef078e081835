"""Configuration files (``--config_path``), checked before LeRobot and draccus parse them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from dualhead_envs.validated_json import read_json, shown
from dualhead_envs.validated_yaml import check_size

#: Largest configuration file, in bytes.
MAX_BYTES = 2**20
KIND, REMEDY = "a training configuration", "give a YAML or JSON file of lerobot-train's fields"


def check_config_file(path: Path) -> None:
    """Refuse a configuration file that is no mapping of plain values of reasonable size.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is none.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist, expected {KIND}: {REMEDY}")
    if path.stat().st_size > MAX_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size} bytes, expected at most {MAX_BYTES}: {REMEDY}")
    content = read_json(path, kind=KIND, remedy=REMEDY) if path.suffix == ".json" else _read_yaml(path)
    if not isinstance(content, dict):
        raise ValueError(f"{path} holds no mapping of fields, expected {KIND}: {REMEDY}")
    policy = content.get("policy")
    if isinstance(policy, dict) and policy.get("type", "dualhead") != "dualhead":
        raise ValueError(
            f"{path} has policy.type = {shown(policy['type'])}, expected 'dualhead': use lerobot-train for other "
            "policies"
        )
    check_size(content, source=str(path), remedy=REMEDY)


def _read_yaml(path: Path) -> Any:
    try:
        return yaml.safe_load(path.read_bytes())
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f" (line {mark.line + 1}, column {mark.column + 1})"
        raise ValueError(f"{path} is not plain YAML{where}, expected {KIND}: {REMEDY}") from error
