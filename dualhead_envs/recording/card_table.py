"""A recorded dataset's geometry card as a terminal table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table


def render_card(card: Mapping[str, Any], title: str = "Geometry card") -> Table:
    """The measured quantities beside the paper's, with what each means.

    Raises:
        ValueError: If the card holds no measured quantities.
    """
    measured = card.get("measured")
    if not isinstance(measured, Mapping):
        raise ValueError(
            f"the card has the fields {sorted(card)}, expected 'measured' among them: record the dataset again"
        )
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("quantity", no_wrap=True)
    table.add_column("measured", justify="right", no_wrap=True)
    table.add_column("paper", justify="right", no_wrap=True)
    table.add_column("meaning")
    for name, value in measured.items():
        printed = card.get("paper", {}).get(name)
        table.add_row(name, _number(value), _number(printed), str(card.get("meanings", {}).get(name, "")))
    return table


def _number(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.4f}" if abs(value) < 1.0 else f"{value:.2f}"
