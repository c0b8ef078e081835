"""The page is one file with every table and figure, and escapes what it is given."""

import re

import pytest

from dualhead_eval.gate import write_gate


def test_the_page_is_self_contained_and_escapes_what_it_is_given(make_gate, report_command, tmp_path, capsys):
    gates = [make_gate("<b>bold & co</b>", 0.7), make_gate("three", 0.5, heads=3, valid=0.8)]
    paths = [write_gate(gate, tmp_path / f"{i}.json") for i, gate in enumerate(gates)]
    page, folder = tmp_path / "report.html", tmp_path / "figures"
    assert report_command(*paths, "--html", page, "--figures", folder, "--paper") == 0
    text = page.read_text()
    assert not re.search(r"""(src|href)=["'](?!data:)""", text)
    assert "<b>bold" not in text
    assert "&lt;b&gt;bold &amp; co&lt;/b&gt;" in text
    assert "nan" not in re.sub(r"base64,[^\"]*", "", text)
    assert "low-validity" in text
    assert {path.stem for path in folder.iterdir()} == {"region", "forest", "heatmap", "strata", "tau", "nfe"}
    assert "claims" in capsys.readouterr().out
    with pytest.raises(FileExistsError, match="--overwrite"):
        report_command(*paths, "--html", page)
