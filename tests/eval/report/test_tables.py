"""Every table is plain cells, and both renderers show every one of them."""

from html import escape
from html.parser import HTMLParser

import pytest

from dualhead_eval.evaluation.rollouts import ClosedLoop
from dualhead_eval.report import terminal
from dualhead_eval.report.content import make_report
from dualhead_eval.report.effects_table import effects_table
from dualhead_eval.report.table import Column, Table
from dualhead_eval.report.tables import families_table, paper_tables, report_tables
from dualhead_eval.report.web.html_table import render_table


class _Cells(HTMLParser):
    """The cells of a page's tables, as text."""

    def __init__(self):
        super().__init__()
        self.cells, self._inside = [], False

    def handle_starttag(self, tag, attrs):
        if tag == "td":
            self._inside = True
            self.cells.append("")

    def handle_endtag(self, tag):
        self._inside = self._inside and tag != "td"

    def handle_data(self, data):
        if self._inside:
            self.cells[-1] += data


def cells_of(html):
    parser = _Cells()
    parser.feed(html)
    return parser.cells


@pytest.fixture(scope="module")
def report(make_gate):
    """A report with something in every table."""
    seeds = [
        make_gate(f"A seed {seed}", 0.1, seed=seed, partition="bypass-v2", config={"seed": seed}) for seed in range(2)
    ]
    pose = make_gate("pose", 0.5, heads=3, partition="bypass-v2")
    return make_report([*seeds, pose], [("loop", ClosedLoop("BimodalBypass-v2", "joint", 150, 149, 1))])


def test_both_renderers_show_every_table(report, printed):
    tables = report_tables(report) + paper_tables(report)
    titles = [table.title for table in tables]
    for title in ("Closed loop", "All heads at once", "Means over seeds (the seed is the unit)"):
        assert title in titles
    for table in tables:
        text, html = printed(terminal.render_table(table), width=200), render_table(table)
        assert table.title in text
        assert escape(table.title) in html
        cells = cells_of(html)
        for row in table.rows:
            for cell, column in zip(row, table.columns, strict=True):
                content = getattr(cell, "text", cell)
                assert content in cells
                if not column.detail:
                    assert all(word in text for word in content.split())


def test_the_effects_print_every_number_with_its_operating_point(make_gate, printed):
    report = make_report([make_gate("my run", 1.0)])
    text = printed(terminal.render_table(effects_table(report)))
    (pair,) = report.pairs
    for cell in ("my run", "0.55", "20", f"{pair.capacity:.4f}", f"{pair.delta:+.4f}", "+100.0% [+100.0,+100.0]"):
        assert cell in text
    assert "nan" not in text


def test_undefined_numbers_are_words(make_gate, printed):
    report = make_report([make_gate("one mode", 1.0, prior=[1.0, 0.0])])
    assert "undefined" in printed(terminal.render_table(effects_table(report)))


@pytest.mark.parametrize("width", [50, 80, 100, 160])
def test_no_column_is_lost_on_a_narrow_terminal(width, report, printed):
    for table in report_tables(report) + paper_tables(report):
        text = printed(terminal.render_table(table), width=width)
        assert max(map(len, text.splitlines())) <= width
        # Words may be broken over lines, numbers are not.
        for row in table.rows:
            for cell, column in zip(row, table.columns, strict=True):
                numbers = [] if column.text or column.detail else getattr(cell, "text", cell).split()
                assert all(number in text for number in numbers), (table.title, column.name)


@pytest.mark.parametrize("label", ["[red]danger[/red]", "[/]", "<b>bold & co</b>", "clear\x1b[2Jscreen", "two\nlines"])
def test_a_label_is_text_wherever_it_is_shown(label, make_gate, printed):
    table = effects_table(make_report([make_gate(label)]))
    text, html = printed(terminal.render_table(table), width=200), render_table(table)
    assert label.replace("\x1b", "\\x1b").replace("\n", "\\n") in text
    assert "\x1b" not in text
    assert "<b>" not in html
    assert "\x1b" not in html


def test_a_loss_stands_in_every_table_that_prints_a_rho(report):
    for table in report_tables(report) + paper_tables(report):
        names = {column.name.partition(" ")[0] for column in table.columns}
        assert ("\N{GREEK SMALL LETTER RHO}" in names) <= ("loss" in names), table.title


def test_a_p_value_at_the_resampling_floor_is_a_bound(make_gate):
    (row,) = effects_table(make_report([make_gate("coupled", 0.5)])).rows
    assert "<= 0.001" in row


def test_families_need_two_seeds_of_one_setting(make_gate):
    assert families_table(make_report([make_gate("alone", 0.6)])) is None


def test_a_row_of_another_length_is_refused():
    with pytest.raises(ValueError, match="row of 2 cells, expected 1"):
        Table("x", (Column("a"),), (("1", "2"),))


def test_a_table_too_wide_for_a_page_goes_on_in_a_second_one():
    wide = Table("wide", tuple(Column(f"c{n}") for n in range(12)), (("run", *["1.000 [0.900,1.100]"] * 11),))
    html = render_table(wide)
    assert html.count("<thead>") == 2
    assert cells_of(html).count("run") == 2
    assert cells_of(html).count("1.000 [0.900,1.100]") == 11
    assert [n for n in range(12) if f">c{n}</th>" not in html] == []
