"""Whatever goes wrong in a command reaches the terminal as one line of text."""

from __future__ import annotations

import pytest

from dualhead_eval import cli


@pytest.fixture
def command(monkeypatch):
    """A way to run a command module, written as a class, through the error door."""

    def run(error):
        class Module:
            @staticmethod
            def add_arguments(parser):
                parser.add_argument("--root")

            @staticmethod
            def run(args):
                raise error

        monkeypatch.setattr(cli.importlib, "import_module", lambda name: Module)
        return lambda *arguments: cli.run_command("module", "dualhead test", list(arguments))

    return run


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (ValueError("two\nlines \x1b[2J"), 2, "dualhead: error: two lines \\x1b[2J"),
        (KeyError("tau=0.7 was not evaluated"), 2, "dualhead: error: tau=0.7 was not evaluated"),
        (FileNotFoundError(2, "No such file", "x\x1b"), 2, "dualhead: error: [Errno 2] No such file: 'x\\x1b'"),
        (TypeError("unhashable\ntype"), 70, "dualhead: unexpected error: TypeError in "),
        (RecursionError("too deep"), 70, "please report it"),
    ],
)
def test_an_error_is_one_line(command, capsys, error, status, line):
    assert command(error)() == status
    written = capsys.readouterr().err
    assert line in written
    assert written.endswith("\n")
    assert written[:-1].isprintable()


def test_an_error_that_is_its_own_cause_ends(command, capsys):
    first, second = ValueError("first"), ValueError("second")
    first.__cause__, second.__cause__ = second, first
    assert command(first)() == 2
    assert capsys.readouterr().err == "dualhead: error: first\n"


def test_the_traceback_of_what_nobody_expected_is_shown_on_request(command, monkeypatch):
    monkeypatch.setenv(cli.TRACEBACK, "1")
    with pytest.raises(TypeError):
        command(TypeError("a defect"))()


@pytest.mark.parametrize("arguments", [("--root", ""), ("--root=",)])
def test_an_empty_value_is_refused(command, capsys, arguments):
    assert command(None)(*arguments) == 2
    assert "--root is empty: give it a value" in capsys.readouterr().err
