"""Flags that count something: at least one."""

from __future__ import annotations

import argparse


def require_counts(args: argparse.Namespace, *names: str) -> None:
    """Refuse flags that ask for none of something.

    Args:
        args: A command's arguments.
        names: Flags without dashes, whole numbers.

    Raises:
        ValueError: If one is below 1; names it.
    """
    for name in names:
        if (given := getattr(args, name)) < 1:
            raise ValueError(f"--{name} {given} is not positive: give at least 1")
