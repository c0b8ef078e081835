"""The answer of a report in two sentences: what the heads do, and how far that can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dualhead_eval.paper.setting import NOTHING, departures
from dualhead_eval.report.content import Report
from dualhead_eval.report.run_groups import RunGroup, group_runs
from dualhead_eval.report.table import RHO, with_bounds
from dualhead_eval.statistics.run import Run
from dualhead_eval.statistics.training_record import settled

#: What the heads of a kind of run do: the first words of its reading, and how a sentence says it.
_DOING = (
    ("coordinated in full", "choose the same mode almost whenever they can, with every mode alive"),
    ("coordinated in part", "choose the same mode more often than chance, and less often than they could"),
    ("uncoordinated", "choose independently of each other"),
    ("anti-coordinated", "avoid each other's mode"),
    ("collapsed", "agree only because they hardly vary"),
    ("unclear", "do not show whether they agree or avoid each other"),
    ("not the same under every seed", "do not do the same under every seed"),
    ("too few valid pairs", "have too few valid pairs to be read"),
)
_SEVERAL, _UNREAD = _DOING[-2][0], _DOING[-1][0]


@dataclass(frozen=True)
class Answer:
    """Two sentences.

    Attributes:
        what: What the heads of these runs do.
        trust: Beside the paper where it has such runs; otherwise seeds and losses.
    """

    what: str
    trust: str


def report_answer(report: Report) -> Answer:
    """The answer of a report with at least one run."""
    groups = group_runs(report.runs)
    if len(groups) == 1:
        return Answer(_one(groups[0]), _trust(report, groups))
    return Answer(_many(groups), _trust(report, groups))


def group_doings(groups: Sequence[RunGroup]) -> dict[str, list[int]]:
    """Positions of the groups by what their heads do at the last checkpoint, in a few words, in one order."""
    found: dict[str, list[int]] = {}
    for index, group in enumerate(groups):
        doings = {_doing(run) for run in group.last}
        found.setdefault(doings.pop() if len(doings) == 1 else _SEVERAL, []).append(index)
    return {doing: found[doing] for doing, _ in _DOING if doing in found}


def _doing(run: Run) -> str:
    reading = run.first.reading
    return next((doing for doing, _ in _DOING if reading.startswith(doing)), _UNREAD)


def _one(group: RunGroup) -> str:
    (doing,) = group_doings([group])
    run = group.last[-1]
    pair, sentence = run.first, dict(_DOING)[doing]
    if doing in (_UNREAD, _SEVERAL):
        return f"The heads of {group.label} {sentence}: {pair.valid_rate:.1%} of the pairs are valid."
    rho = with_bounds(pair.rho, pair.intervals["rho"], "+.1%")
    return (
        f"The heads of {group.label} {sentence}: {RHO} = {rho} of the coordination that their variety allows, "
        f"in the {pair.valid_rate:.1%} of pairs in which both reach a mode."
    )


def _many(groups: Sequence[RunGroup]) -> str:
    sentences = dict(_DOING)
    parts = [
        f"in {len(indices)} {'they' if number else f'of {len(groups)} kinds of run the heads'} {sentences[doing]}"
        for number, (doing, indices) in enumerate(group_doings(groups).items())
    ]
    sentence = parts[0] if len(parts) == 1 else "; ".join(parts[:-1]) + "; and " + parts[-1]
    return f"I{sentence[1:]}."


def _trust(report: Report, groups: Sequence[RunGroup]) -> str:
    last = [run for group in groups for run in group.last]
    sites = [site for site in report.sites if any(site.run is run for run in last)]
    if sites:
        parts = []
        assigned = [site for site in sites if site.agrees is not None]
        spread = [site for site in sites if site.within_spread is not None]
        if assigned:
            parts.append(f"{sum(site.agrees is True for site in assigned)} of {len(assigned)} lie at the paper's site")
        if spread:
            inside = sum(site.within_spread is True for site in spread)
            parts.append(f"{inside} of {len(spread)} within the spread of its seeds")
        alike = sum(departures(site.run.training) == NOTHING for site in sites)
        trained = "none" if alike == 0 else f"{alike}"
        text = " and ".join(parts) or f"{len(sites)} have a row"
        return (
            f"Beside the paper, {text}; {trained} of them {'was' if alike < 2 else 'were'} trained as the paper's "
            + ("in all that is known.")
        )
    seeds = {len({run.training.seed for run in group.last if run.training.seed is not None}) for group in groups}
    trained_runs = [run.training for run in last if not run.training.reference]
    if not trained_runs or seeds == {0}:
        return "Nothing is known of a training behind these numbers; the intervals are over conditions."
    count = f"{min(seeds)}" if len(seeds) == 1 else f"{min(seeds)} to {max(seeds)}"
    return (
        f"This rests on {count} training seed{'' if seeds == {1} else 's'} each, with a flow loss that is "
        f"{settled(trained_runs)} at the last checkpoint; intervals are over conditions."
    )
