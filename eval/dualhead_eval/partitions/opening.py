"""Opening the partition that a command line names: a file, a clustering of end points, or code that the user trusts."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path

import numpy as np

from dualhead_eval.partitions.nearest import EndpointPartition
from dualhead_eval.partitions.partition_file import read_partition
from dualhead_eval.partitions.scored import ScoredPartition

#: Seed of a clustering that the command line asks for.
SEED = 0
_FORMS = "FILE.json, endpoint:K or module:attribute"


def open_partition(spec: str, paths: np.ndarray) -> ScoredPartition:
    """The partition that ``spec`` names.

    Only here is code named by a string imported, and only because the user typed it; nothing that a file says reaches
    this function.

    Args:
        spec: ``FILE.json`` (see :mod:`dualhead_eval.partitions.partition_file`); ``endpoint:K``, which clusters the end
            points of ``paths`` into K; or ``module:attribute``, a partition or what makes one without arguments, the
            module also found in the working directory.
        paths: The paths (..., H, d) that are to be labelled.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If ``spec`` has no such form or names no partition.
    """
    if spec.endswith(".json"):
        return ScoredPartition(read_partition(spec))
    clusters = re.fullmatch(r"endpoint:(\d{1,4})", spec)
    if clusters:
        return ScoredPartition(EndpointPartition.fit(paths, int(clusters[1]), seed=SEED))
    module, colon, attribute = spec.partition(":")
    if not colon or not all(part.isidentifier() for part in (*module.split("."), attribute)):
        raise ValueError(f"--partition {spec!r} has none of the forms {_FORMS}: choose one of these")
    return ScoredPartition(_imported(module, attribute))


def _imported(module: str, attribute: str):
    before, here = list(sys.path), str(Path.cwd())
    sys.path.insert(0, here)
    try:
        found = getattr(importlib.import_module(module), attribute)
        return found() if isinstance(found, type) or not hasattr(found, "assign") else found
    except Exception as error:  # what a user's module raises is theirs to see, in one line
        raise ValueError(
            f"--partition {module}:{attribute} gives no partition ({type(error).__name__}: {error}), expected an "
            f"object with assign, n_modes, tau and to_dict: check the module's name and that it imports from {here}"
        ) from error
    finally:
        sys.path[:] = before
