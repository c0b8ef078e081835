"""docs/results.md is what the template and the committed results give."""

from pathlib import Path

import pytest

from dualhead_eval.gate import read_gate, write_gate
from dualhead_eval.results_page import ensembles
from dualhead_eval.results_page.__main__ import PAGE, TEMPLATE, main, results_page
from dualhead_eval.results_page.consistency import consistency_table, ladder_table
from dualhead_eval.results_page.families import COLUMNS, family_table
from dualhead_eval.results_page.graded_studies import graded_studies
from dualhead_eval.results_page.studies import NOTHING, study_sections
from dualhead_eval.results_page.template import filled, markdown_table
from dualhead_eval.statistics.run_summary import residual_mm, summarise_run

ROOT = Path(__file__).parents[3]


@pytest.fixture
def in_the_clone(monkeypatch):
    monkeypatch.chdir(ROOT)


def test_the_committed_page_has_not_drifted(in_the_clone):
    written = results_page()
    assert PAGE.read_text(encoding="utf-8") == written, "run `python -m dualhead_eval.results_page`"


def test_a_line_of_the_table_says_what_its_gate_file_says(in_the_clone):
    gate = read_gate(ROOT / "results/v3/G_consistency_3-10k.gate.json.gz")
    pair = summarise_run(gate)
    lines = [line for line in family_table(["results/v3"]).splitlines() if line.startswith("| v3 G_consistency_3 ")]
    (cells,) = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    line = dict(zip(COLUMNS, cells, strict=True))
    interval = pair.intervals["rho"]
    assert line["rho, ours"] == f"{100 * pair.rho:+.1f} % [{100 * interval.low:+.1f}, {100 * interval.high:+.1f}]"
    assert line["valid, ours / paper"] == f"{pair.valid_rate:.3f} / 0.445"
    assert line["residual mm, ours / paper"] == f"{residual_mm(gate):.1f} / 60.8"
    assert line["paper"] == "+63.2 %"
    assert line["steps"] == "10,000"


def test_the_optimum_stands_beneath_the_runs_of_its_loss(in_the_clone):
    lines = consistency_table(["v3", "results/v3=mine"]).splitlines()
    assert lines[2].startswith("| the paper (3 seeds) | 50,000 | 0.445 | +63.2 %")
    assert lines[3].startswith("| G_consistency_3, mine | 10,000")
    assert lines[-1].startswith("| **the optimum** |")


def test_the_ladder_is_that_of_two_equally_likely_modes(in_the_clone):
    assert (ROOT / "results/optimum/p92_consistency_3.gate.json.gz").is_file()  # beside it, under the same map
    line = ladder_table(["results/ring"]).splitlines()[-1]
    optimum = summarise_run(read_gate(ROOT / "results/optimum/nullspace_consistency_3.gate.json.gz"))
    assert line.startswith(f"| 3 | {100 * optimum.rho:+.1f} % ")


def test_a_template_keeps_its_text_and_fills_its_lines():
    text = "# Title\n\n<!-- insert double 'a b' c -->\n<!-- a comment -->\n"
    page = filled(text, {"double": lambda words: "\n".join(words * 2)}, source="t.md")
    assert page == "# Title\n\na b\nc\na b\nc\n<!-- a comment -->\n"


def test_bars_are_escaped():
    assert markdown_table(["a"], [["x|y"]]).splitlines()[-1] == "| x\\|y |"


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("<!-- insert tables -->", "line 2, asks for 'tables', expected one of"),
        ("<!-- insert families results/none -->", "line 2: .*results/none"),
        ("<!-- insert families -->", "line 2: no folder of results is named"),
        ("<!-- insert consistency v4 results/v3 -->", "line 2: .*expected one of these"),
        ("<!-- insert optimum results/v3 -->", "line 2: .*takes no arguments"),
        ("<!-- insert closed_loop results/v3 -->", "line 2: results/v3 holds no"),
        ("<!-- insert studies all -->", "line 2: this line takes no arguments, 'all'"),
        ("<!-- insert claims all -->", "line 2: this line takes no arguments, 'all'"),
    ],
)
def test_what_cannot_be_inserted_is_named_with_its_line(in_the_clone, tmp_path, line, sentence):
    template = tmp_path / "template.md"
    template.write_text(f"# Title\n{line}\n")
    with pytest.raises(ValueError, match=sentence):
        results_page(template)


def test_checking_writes_nothing_and_tells_a_page_that_has_drifted(tmp_path, monkeypatch, capsys, make_gate):
    monkeypatch.chdir(tmp_path)
    assert main(["--check"]) == 2
    assert "docs/results.template.md does not exist" in capsys.readouterr().err
    (tmp_path / "docs").mkdir()
    TEMPLATE.write_text("# Mine\n\n<!-- insert families results -->\n")
    write_gate(make_gate("my run", 0.5), tmp_path / "results" / "mine.gate.json")
    assert main(["--check"]) == 1
    assert "is not what the results give" in capsys.readouterr().err
    assert not PAGE.exists()
    assert main([]) == 0
    assert "my run" in PAGE.read_text()
    assert main(["--check"]) == 0
    write_gate(make_gate("my run", 0.9), tmp_path / "results" / "mine.gate.json", overwrite=True)
    from dualhead_eval.results_page import folders

    folders._opened.cache_clear()
    assert main(["--check"]) == 1


def test_without_results_studies_and_ensembles_say_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert study_sections(graded_studies()) == NOTHING
    assert ensembles.ensemble_sections([]) == ensembles.NOTHING


def test_an_ensembles_gate_files_make_two_tables(tmp_path, monkeypatch, make_gate):
    monkeypatch.chdir(tmp_path)
    for score, shared in (("private", False), ("shared", True)):
        gate = make_gate("five seeds", 0.8 * shared, method="ensemble", shared_noise=shared, score="action_l2")
        gate.strata["joint / position"] = gate.strata.pop("position")
        write_gate(gate, tmp_path / "results" / "ensembles" / "A" / f"{score}.gate.json.gz")
    page = ensembles.ensemble_sections([])
    assert page.count("| five seeds | private |") == 1
    assert page.count("| five seeds | Action-L2 | shared |") == 1
    write_gate(make_gate("policy"), tmp_path / "results" / "ensembles" / "A" / "vfd.gate.json")
    with pytest.raises(ValueError, match=r"vfd\.gate\.json is no ensemble's"):
        ensembles.ensemble_sections([])
