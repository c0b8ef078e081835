"""``python -m dualhead_eval``: the evaluate and report commands of ``dualhead``."""

from __future__ import annotations

import argparse
import sys

from dualhead_eval.cli import COMMANDS, run_command


def main(arguments: list[str] | None = None) -> int:
    """Run one command; errors the user can fix are one line on standard error and exit status 2."""
    arguments = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(prog="python -m dualhead_eval", description=__doc__, allow_abbrev=False)
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("evaluate", "report"):
        commands.add_parser(name, help=COMMANDS[name][1], add_help=False)
    name = parser.parse_known_args(arguments)[0].command
    rest = list(arguments)
    rest.remove(name)
    return run_command(COMMANDS[name][0], f"python -m dualhead_eval {name}", rest)


if __name__ == "__main__":
    sys.exit(main())
