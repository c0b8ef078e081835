"""The examples in the docstrings run and print what they say."""

import doctest
import importlib

import pytest


@pytest.mark.parametrize(
    "name",
    [
        "effects.contingency",
        "effects.counts",
        "effects.dependence",
        "certificate.certificate",
        "cli",
        "gate.consistency",
    ],
)
def test_docstring_examples(name):
    module = importlib.import_module(f"dualhead_eval.{name}")
    result = doctest.testmod(module)
    assert result.attempted > 0
    assert result.failed == 0
