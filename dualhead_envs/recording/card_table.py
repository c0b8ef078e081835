"""A recorded dataset's geometry card as a terminal table."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from dualhead_envs.recording.geometry_card import GeometryCard, Quantity


def render_card(card: GeometryCard, title: str = "Geometry card") -> Table:
    """The measured quantities beside the paper's, with what each means."""
    table = Table(title=Text(title), title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("quantity", no_wrap=True)
    table.add_column("measured", justify="right", no_wrap=True)
    table.add_column("paper", justify="right", no_wrap=True)
    table.add_column("meaning")
    for name, value in card.measured.items():
        printed = card.paper.get(name)
        # Text is never markup: names and meanings come from a file.
        table.add_row(Text(name), _number(value), _number(printed), Text(card.meanings.get(name, "")))
    return table


def _number(value: Quantity) -> str:
    if value is None:
        return "-"
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.4f}" if abs(value) < 1.0 else f"{value:.2f}"
