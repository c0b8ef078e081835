"""The page as a browser shows it, on a desktop and on a phone, in both colour schemes, without a network.

Run with `uv run --group browser pytest -m browser`. It drives the Chromium of the system (`apt-get install chromium`).
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from dualhead_eval.evaluation.rollouts import ClosedLoop
from dualhead_eval.report.content import make_report
from dualhead_eval.report.figures.figures import report_figures
from dualhead_eval.report.monitor_page import monitor_page
from dualhead_eval.report.page import report_page
from dualhead_eval.report.table import Cell, Column, Table

pytestmark = pytest.mark.browser
LOOKS = [(width, scheme) for width in (390, 1280) for scheme in ("light", "dark")]
#: WCAG 2.1: contrast of text, and of large text.
CONTRAST, LARGE_CONTRAST = 4.5, 3.0

_OVERFLOWING = """() => [...document.querySelectorAll("body *")].filter((element) => {
  const box = element.getBoundingClientRect();
  const hidden = box.width <= 1 || element.closest("thead")?.getBoundingClientRect().width <= 1;
  return !hidden && (box.right > window.innerWidth + 0.5 || box.left < -0.5);
}).map((element) => element.tagName + " " + element.textContent.slice(0, 60))"""

_CONTRASTS = """() => {
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgba = (colour) => {
    canvas.clearRect(0, 0, 1, 1);
    canvas.fillStyle = colour;
    canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data];
  };
  const luminance = (colour) => {
    const [r, g, b] = colour.map((v) => (v / 255 <= 0.04045 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ratio = (one, other) => {
    const [dark, light] = [luminance(one), luminance(other)].sort((a, b) => a - b);
    return (light + 0.05) / (dark + 0.05);
  };
  const ground = (element) => {
    for (let at = element; at; at = at.parentElement) {
      const colour = rgba(getComputedStyle(at).backgroundColor);
      if (colour[3] === 255) return colour;
    }
    throw new Error("no ground below " + element.tagName);
  };
  const found = [];
  for (const element of document.querySelectorAll("body *")) {
    const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    if (!own || !element.getClientRects().length || element.closest("script")) continue;
    const style = getComputedStyle(element);
    const drawn = element.closest("svg") !== null;
    const ink = rgba(drawn ? style.fill : style.color);
    const grounds = [ground(element)];
    if (drawn) grounds.push(rgba(getComputedStyle(document.querySelector(".region .out")).fill));
    const size = parseFloat(style.fontSize);
    const large = size >= 24 || (size >= 18.66 && parseInt(style.fontWeight) >= 700);
    for (const under of grounds) found.push([ratio(ink, under), large, element.textContent.trim().slice(0, 60)]);
  }
  return found;
}"""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """The system's Chromium."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is missing: uv run --group browser pytest")
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        pytest.skip("no browser on this machine, the pages were not looked at: apt-get install chromium")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def page_file(make_gate, tmp_path_factory) -> Path:
    """A report with something in every table: seeds and checkpoints, three heads, hostile and endless labels."""
    gates = [
        make_gate(
            f"tokens seed {seed}, {steps} steps",
            couple,
            partition="bypass-v2",
            seed=10 * seed + number,
            config={"seed": seed, "token": "oracle"},
            training={"steps": 50_000, "seed": seed},
            training_step=steps,
            checkpoint=f"{seed}-{steps}",
        )
        for seed in range(2)
        for number, (steps, couple) in enumerate(((20_000, 0.5), (50_000, 0.95)))
    ]
    gates.append(make_gate("A_independent", 0.0, partition="bypass-v2", config={"seed": 5, "source_noise_beta": 1.0}))
    gates.append(make_gate("pose", 0.5, heads=3, partition="bypass-v2", weak=True))
    gates.append(make_gate("w_" * 45, 0.3, valid=0.4, partition="bypass-v2", flip=True))
    gates.append(make_gate("<script>console.error('label ran')</script>", 1.0, prior=[1.0, 0.0]))
    report = make_report(gates, [("loop", ClosedLoop("BimodalBypass-v2", "joint", 150, 149, 1))])
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(report_page(report, report_figures(report)), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def monitor_file(tmp_path_factory) -> Path:
    """A page of a monitor's tables, one of them wide."""
    names = [f"quantity {number}" for number in range(9)]
    columns = (Column("signal", text=True), *(Column(name, f"what {name} means") for name in names))
    rows = (("residual_energy", *["0.912 [0.881,0.934]"] * 9), ("stac", Cell("undefined"), *["-"] * 8))
    path = tmp_path_factory.mktemp("page") / "monitor.html"
    path.write_text(monitor_page([Table("What the signals detect", columns, rows)], {}), encoding="utf-8")
    return path


def opened(
    chromium: Any, path: Path, width: int = 1280, scheme: str = "light", **options: Any
) -> tuple[Any, list[str]]:
    """A page with everything unfolded, and the list that its complaints and requests go to."""
    context = chromium.new_context(
        viewport={"width": width, "height": 900}, color_scheme=scheme, offline=True, **options
    )
    page, complaints = context.new_page(), []
    page.on("console", lambda message: complaints.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on(
        "request", lambda request: complaints.append(request.url) if request.url[:5] not in ("file:", "data:") else 0
    )
    page.goto(path.as_uri())
    if options.get("java_script_enabled", True):
        page.evaluate("() => { for (const folded of document.querySelectorAll('details')) folded.open = true; }")
    return page, complaints


@pytest.mark.parametrize(("width", "scheme"), LOOKS)
@pytest.mark.parametrize("which", ["page_file", "monitor_file"])
def test_a_page_fits_reads_and_asks_for_nothing(which, width, scheme, chromium, request):
    page, complaints = opened(chromium, request.getfixturevalue(which), width, scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate(_OVERFLOWING) == []
    faint = [
        (round(ratio, 2), content)
        for ratio, large, content in page.evaluate(_CONTRASTS)
        if ratio < (LARGE_CONTRAST if large else CONTRAST)
    ]
    assert faint == []
    levels = page.evaluate("[...document.querySelectorAll('h1, h2, h3, h4')].map((h) => Number(h.tagName[1]))")
    assert levels.count(1) == 1
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    assert page.evaluate("[...document.images].every((image) => image.alt.trim() && image.naturalWidth > 0)")
    assert page.evaluate("[...document.querySelectorAll('button, summary')].every((b) => b.textContent.trim())")
    assert page.evaluate("[...document.querySelectorAll('svg')].every((s) => s.getAttribute('aria-label').trim())")
    assert page.title()
    assert page.locator("html").get_attribute("lang") == "en"
    assert complaints == []


def test_the_answer_comes_first_and_the_details_are_folded(chromium, page_file):
    page, _ = opened(chromium, page_file)
    page.reload()
    headings = page.locator("h1, h2").all_inner_texts()
    assert headings[0] == "Do the heads choose modes together?"
    assert headings[-2:] == ["What differs from the paper", "Details"]
    assert page.locator(".answer").count() == 2
    assert page.locator("svg").bounding_box()["y"] < 500
    assert page.locator("details.section[open]").count() == 0
    assert page.locator("img").first.is_visible() is False


def test_a_pointer_and_the_keyboard_show_a_run(chromium, page_file):
    page, complaints = opened(chromium, page_file)
    tip = page.locator(".tip")
    assert not tip.is_visible()
    point = page.locator(".run", has=page.locator("circle")).first
    point.locator("circle").hover(force=True)
    said = tip.inner_text()
    for words in (
        "tokens seed 0, 20000 steps",
        "\N{GREEK SMALL LETTER RHO} = +",
        "valid pairs",
        "seed 0",
        "coordinated in part",
    ):
        assert words in said
    page.mouse.move(5, 5)
    assert not tip.is_visible()
    point.focus()
    page.keyboard.press("ArrowRight")
    assert "50000 steps" in tip.inner_text()
    page.keyboard.press("Escape")
    assert not tip.is_visible()
    name = page.locator(".names button", has_text="tokens")
    name.click()
    assert name.get_attribute("aria-pressed") == "true"
    assert page.locator(".run.picked").count() == 4
    assert page.locator(".training.picked").count() == 2
    name.click()
    assert page.locator(".run.picked").count() == 0
    assert complaints == []


def test_headers_stay_in_sight(chromium, page_file):
    page, _ = opened(chromium, page_file, 1280)
    table = page.get_by_role("table", name="Every run and its effect").first
    table.locator("tbody tr").nth(3).evaluate("(row) => window.scrollBy(0, row.getBoundingClientRect().top - 60)")
    assert table.locator("thead th").first.bounding_box()["y"] == pytest.approx(0, abs=1)
    phone, _ = opened(chromium, page_file, 390)
    table = phone.get_by_role("table", name="Every run and its effect").first
    heading = table.locator("tr.group").first
    table.locator("tbody.grouped tr").nth(2).evaluate(
        "(row) => window.scrollBy(0, row.getBoundingClientRect().top - 60)"
    )
    assert heading.bounding_box()["y"] == pytest.approx(0, abs=1)


def test_without_a_script_every_point_still_says_its_run(chromium, page_file):
    page, complaints = opened(chromium, page_file, java_script_enabled=False)
    points = page.locator(".run")
    assert points.count() == 10  # seven runs of two heads, and three pairs of the one with three
    assert all("valid pairs" in title for title in page.locator(".run title").all_text_contents())
    assert complaints == []
