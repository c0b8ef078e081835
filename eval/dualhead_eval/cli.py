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
    "sweep": ("dualhead_eval.commands.sweep", "train configurations x datasets x seeds as few programs, resumable"),
    "study": ("dualhead_eval.commands.study", "run a study of the paper from its file to its verdict"),
    "evaluate": ("dualhead_eval.commands.evaluate", "sample a policy under test conditions into a gate file"),
    "ensemble": ("dualhead_eval.commands.ensemble", "split what an ensemble's members disagree about by their modes"),
    "report": ("dualhead_eval.commands.report", "turn gate files into tables, figures and verdicts"),
    "monitor": ("dualhead_eval.commands.monitor", "fit failure monitors on rollouts, score and report them"),
    "certify": ("dualhead_eval.commands.certify", "let LeRobot's rollouts of a policy come to a coordination verdict"),
    "info": ("dualhead_eval.commands.info", "print versions, environments and registered types"),
    "demo": ("dualhead_eval.commands.demo", "the whole pipeline in minutes: record, train, evaluate, report"),
}
#: Environment variable with which an unexpected error shows its traceback.
TRACEBACK = "DUALHEAD_TRACEBACK"
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
    """Run a command module; user errors are one line and status 2, Ctrl-C is one line and status 130."""
    try:
        return _parse_and_run(module_name, prog, arguments)
    except BrokenPipeError:
        # The reader of a pipe has gone (`dualhead report ... | head`): not an error of ours.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (Exception, KeyboardInterrupt) as error:
        if _was_interrupted(error):
            print("dualhead: interrupted", file=sys.stderr)
            return 130
        if isinstance(error, USER_ERRORS):
            print(f"dualhead: error: {one_line(_sentence(error))}", file=sys.stderr)
            return 2
        if os.environ.get(TRACEBACK):
            raise
        print(f"dualhead: unexpected error: {_unexpected(error)}", file=sys.stderr)
        return 70


def one_line(message: object) -> str:
    r"""A message on one line, with every control code written out: it may quote a file.

    >>> print(one_line("two\nlines and a \x1b[2J"))
    two lines and a \x1b[2J
    """
    words = " ".join(str(message).split())
    return "".join(character if character.isprintable() else ascii(character)[1:-1] for character in words)


def _unexpected(error: BaseException) -> str:
    """What to say of an error that no user should be able to cause: where it was raised, and how to see more."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    where = f" in {os.path.basename(trace.tb_frame.f_code.co_filename)}, line {trace.tb_lineno}" if trace else ""
    return (
        f"{type(error).__name__}{where} ({one_line(error)[:200]}): please report it with the command that you ran; "
        f"{TRACEBACK}=1 shows the traceback"
    )


def _parse_and_run(module_name: str, prog: str, arguments: list[str]) -> int:
    """Parse ``arguments`` as a command module defines them, and run it."""
    for before, argument in zip(["", *arguments], arguments, strict=False):
        if argument == "" or (argument.startswith("--") and argument.endswith("=")):
            raise ValueError(f"{argument.rstrip('=') or before or 'an argument'} is empty: give it a value")
    module = importlib.import_module(module_name)
    parser = argparse.ArgumentParser(prog=prog, description=getattr(module, "DESCRIPTION", None), allow_abbrev=False)
    module.add_arguments(parser)
    args, remaining = parser.parse_known_args(arguments)
    passes_on = getattr(args, "takes_remaining", False)
    if remaining and not passes_on:
        parser.error(f"unrecognized arguments: {' '.join(remaining)}")
    return module.run(args, remaining) if passes_on else module.run(args)


def _was_interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind ``error``: a library that it meets while importing may raise an error of its own."""
    seen: set[int] = set()  # an error raised from what it caused is its own cause in the end
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False


def _sentence(error: BaseException) -> object:
    if isinstance(error, KeyError) and error.args:
        return error.args[0]
    if isinstance(error, OSError) and error.filename is None and error.strerror:
        return error.strerror  # a sentence of ours; with the error's number in front it would not be one
    return error


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
