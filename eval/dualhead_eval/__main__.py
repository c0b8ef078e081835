"""``python -m dualhead_eval``: the evaluate and report commands without the rest of the package."""

from __future__ import annotations

import argparse
import importlib
import sys

COMMANDS = {
    "evaluate": "sample a policy, label its modes and write a gate file",
    "report": "turn gate files into a table, JSON and figures",
}


def main(arguments: list[str] | None = None) -> int:
    """Run one command; errors the user can fix are one line on standard error and exit status 2."""
    parser = argparse.ArgumentParser(prog="python -m dualhead_eval", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    for name, summary in COMMANDS.items():
        module = importlib.import_module(f"dualhead_eval.{name}_command")
        command = commands.add_parser(name, help=summary, description=getattr(module, "DESCRIPTION", summary))
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    args = parser.parse_args(arguments)
    try:
        return args.run(args)
    except (ValueError, KeyError, FileNotFoundError, FileExistsError) as error:
        message = error.args[0] if isinstance(error, KeyError) and error.args else error
        print(f"dualhead: error: {message}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
