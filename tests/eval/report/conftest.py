"""What a report shows, read back as a reader sees it."""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable

import pytest
from rich.console import Console

from dualhead_eval.commands.report import add_arguments, run


@pytest.fixture(scope="session")
def printed() -> Callable[..., str]:
    """A renderable as a terminal of some width prints it."""

    def print_it(renderable: object, width: int = 140) -> str:
        console = Console(width=width, record=True, file=io.StringIO())
        console.print(renderable)
        return console.export_text()

    return print_it


@pytest.fixture(scope="session")
def report_command() -> Callable[..., int]:
    """``dualhead report`` with the arguments given."""

    def run_it(*arguments: object) -> int:
        parser = argparse.ArgumentParser()
        add_arguments(parser)
        return run(parser.parse_args([str(argument) for argument in arguments]))

    return run_it
