"""``python -m dualhead_eval.results_page``: write docs/results.md, or check it against what the results give."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dualhead_eval.results_page.graded_studies import GradedStudy
    from dualhead_eval.results_page.template import Insert

TEMPLATE, PAGE = Path("docs") / "results.template.md", Path("docs") / "results.md"
NOTE = (
    "<!-- Written by `python -m dualhead_eval.results_page` from docs/results.template.md, results/ and studies/: edit "
    "the template, not this page. -->\n"
)


def results_page(template: Path = TEMPLATE) -> str:
    """The page that the template and the results under the working directory give.

    Raises:
        FileNotFoundError: If there is no template.
        ValueError: If it asks for what there is not.
    """
    from dualhead_eval.results_page.claims import claims_table
    from dualhead_eval.results_page.consistency import consistency_table, ladder_table, optimum_table
    from dualhead_eval.results_page.ensembles import ensemble_sections
    from dualhead_eval.results_page.families import family_table
    from dualhead_eval.results_page.graded_studies import graded_studies
    from dualhead_eval.results_page.loops import closed_loop_table
    from dualhead_eval.results_page.studies import study_sections
    from dualhead_eval.results_page.template import filled

    if not template.is_file():
        raise FileNotFoundError(
            f"{template} does not exist, expected the page's template: run this in a clone's folder"
        )
    studies = cache(graded_studies)

    def of_studies(insert: Callable[[Sequence[GradedStudy]], str]) -> Insert:
        def filled_in(arguments: list[str]) -> str:
            if arguments:
                raise ValueError(f"this line takes no arguments, {' '.join(arguments)!r} was given")
            return insert(studies())

        return filled_in

    inserts = {
        "families": family_table,
        "consistency": consistency_table,
        "optimum": optimum_table,
        "ladder": ladder_table,
        "closed_loop": closed_loop_table,
        "ensembles": ensemble_sections,
        "claims": of_studies(claims_table),
        "studies": of_studies(study_sections),
    }
    return NOTE + filled(template.read_text(encoding="utf-8"), inserts, source=str(template))


def main(arguments: list[str] | None = None) -> int:
    """Write or check the page; 1 if it has drifted, 2 if it cannot be made."""
    parser = argparse.ArgumentParser(prog="python -m dualhead_eval.results_page", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if the page has drifted")
    args = parser.parse_args(arguments)
    try:
        text = results_page()
    except (FileNotFoundError, ValueError) as error:
        print(f"results page: error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    if args.check:
        current = PAGE.read_text(encoding="utf-8") if PAGE.is_file() else ""
        if current == text:
            return 0
        print(f"{PAGE} is not what the results give: run `python -m dualhead_eval.results_page`", file=sys.stderr)
        return 1
    from dualhead_eval.atomic_text import write_text

    write_text(PAGE, text)
    print(PAGE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
