"""The site builds without a warning, and its notebooks are the tutorials' code and run.

The site and the notebooks' kernel need `uv run --group docs pytest -m slow tests/test_documentation.py`.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).parents[1]
SPEC = importlib.util.spec_from_file_location("make_notebooks", ROOT / "docs" / "make_notebooks.py")
make_notebooks = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(make_notebooks)


@pytest.mark.parametrize("page", make_notebooks.PAGES)
def test_a_notebook_is_its_tutorial(page):
    file = ROOT / "docs" / "notebooks" / f"{page}.ipynb"
    assert file.read_text(encoding="utf-8") == make_notebooks.text_of(page), "run python docs/make_notebooks.py"
    code = [cell for cell in make_notebooks.notebook_of(page)["cells"] if cell["cell_type"] == "code"]
    assert len(code) > 3
    assert file.stat().st_size < 50_000


def test_the_pictures_are_light_and_described():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    shown = [
        (page, *found) for page in pages for found in re.findall(r"!\[([^\]]*)\]\(([^)]+)\)", page.read_text("utf-8"))
    ]
    assert any(target.endswith("both_ways.webp") for _, _, target in shown)
    for page, described, target in shown:
        assert described.strip(), f"{page.name} shows {target} without a description"
        assert (page.parent / target).stat().st_size < 3_000_000
    film = Image.open(ROOT / "docs" / "images" / "both_ways.webp")
    assert film.n_frames > 30  # it moves


@pytest.mark.slow
@pytest.mark.parametrize("page", make_notebooks.PAGES)
def test_a_notebook_runs(page, tmp_path):
    nbformat = pytest.importorskip("nbformat", reason="notebooks need `uv run --group docs`")
    client = pytest.importorskip("nbclient", reason="notebooks need `uv run --group docs`")
    notebook = nbformat.read(ROOT / "docs" / "notebooks" / f"{page}.ipynb", as_version=4)
    nbformat.validate(notebook)
    client.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert outputs
    assert all(output.output_type == "stream" and output.name == "stdout" for output in outputs)


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("mkdocs", reason="the site needs `uv run --group docs`")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", tmp_path / "site"]
    # Material announces MkDocs 2 on every build, unless it is told not to.
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    page = (tmp_path / "site" / "reference" / "certificate" / "index.html").read_text(encoding="utf-8")
    assert "CoordinationCertificate" in page
    # Nothing is fetched from elsewhere to read a page.
    sources = re.findall(r"""<(?:script|img|link)[^>]+(?:src|href)=["'](https?:[^"']+)""", page)
    assert [source for source in sources if 'rel="canonical"' not in source] == []
