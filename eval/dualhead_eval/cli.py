"""The ``dualhead`` command. Nothing heavy is imported before a subcommand runs."""

from __future__ import annotations

import argparse
import importlib
import os
import sys

#: Subcommand -> (module, one line for the overview).
COMMANDS = {
    "record": ("dualhead_envs.record_command", "record scripted demonstrations as LeRobotDatasets"),
    "train": (
        "dualhead_policy.training.train_command",
        "train policies, many times faster than lerobot-train",
    ),
    "evaluate": ("dualhead_eval.commands.evaluate", "sample a policy under test conditions into a gate file"),
    "report": ("dualhead_eval.commands.report", "turn gate files into tables, figures and verdicts"),
    "demo": ("dualhead_eval.commands.demo", "the whole line in minutes: record, train, evaluate, report"),
}
# OSError: what is missing, occupied, locked by another process or full.
USER_ERRORS = (ValueError, KeyError, OSError)


def main(arguments: list[str] | None = None) -> int:
    """Run one subcommand; errors the user can fix are one line on standard error and exit status 2."""
    arguments = sys.argv[1:] if arguments is None else arguments
    name = arguments[0] if arguments else None
    if name not in COMMANDS:
        return _overview(arguments)
    return run_command(COMMANDS[name][0], f"dualhead {name}", arguments[1:])


def run_command(module_name: str, prog: str, arguments: list[str]) -> int:
    """Parse ``arguments`` as a command module defines them, run it and turn user errors into one line."""
    module = importlib.import_module(module_name)
    parser = argparse.ArgumentParser(prog=prog, description=getattr(module, "DESCRIPTION", None), allow_abbrev=False)
    module.add_arguments(parser)
    args, remaining = parser.parse_known_args(arguments)
    passes_on = getattr(args, "takes_remaining", False)
    if remaining and not passes_on:
        parser.error(f"unrecognized arguments: {' '.join(remaining)}")
    try:
        return module.run(args, remaining) if passes_on else module.run(args)
    except BrokenPipeError:
        # The reader of a pipe has gone (`dualhead report ... | head`): not an error of ours.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except USER_ERRORS as error:
        message = error.args[0] if isinstance(error, KeyError) and error.args else error
        print(f"dualhead: error: {message}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("dualhead: interrupted", file=sys.stderr)
        return 130


def _overview(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(
        prog="dualhead",
        description="Environments, policies and coordination metrics for dual-head robot policies.",
        epilog="`dualhead COMMAND --help` explains a command; `dualhead demo` shows everything once.",
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    commands = parser.add_subparsers(metavar="COMMAND", title="commands")
    for name, (_, summary) in COMMANDS.items():
        commands.add_parser(name, help=summary)
    args = parser.parse_args(arguments)
    if args.version:
        from importlib.metadata import version

        print(f"dualhead {version('lerobot_policy_dualhead')}")
        return 0
    parser.print_help()
    return 2


if __name__ == "__main__":
    sys.exit(main())
