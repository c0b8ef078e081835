"""Bad input of every format that a command reads."""

from __future__ import annotations

from collections.abc import Iterator

from bad_command_lines import command_line_cases
from bad_datasets import dataset_cases, document_cases
from bad_gates import gate_cases
from bad_policies import lerobot_policy_cases, policy_cases, run_cases
from cases import Case, Products


def all_cases(products: Products) -> Iterator[Case]:
    """Every case, in an order that does not change."""
    yield from gate_cases(products)
    yield from document_cases(products)
    yield from dataset_cases(products)
    yield from policy_cases(products)
    yield from lerobot_policy_cases(products)
    yield from run_cases(products)
    yield from command_line_cases(products)
