"""Tables of ensembles: do the members choose modes together, and what are their disagreement scores made of?"""

from __future__ import annotations

from collections.abc import Sequence

from dualhead_eval.ensembles.summary import OverPairs, paper_ensemble, summarise_ensemble
from dualhead_eval.gate import Gate
from dualhead_eval.paper.numbers import PaperNumber, paper_numbers
from dualhead_eval.report.table import RHO, Column, Table, number

#: A score, and the noise under which it was taken, in words.
SCORES = {"action_l2": "Action-L2", "vfd_unweighted": "VFD, unweighted", "vfd": "VFD"}
_ACTION_L2_PRIVATE = "v2/action l2"


def ensemble_choices_table(gates: Sequence[Gate]) -> Table:
    """Obs, effect and valid pairs of the members' modes beside tab:crn; one line a gate of Action-L2."""
    rows = []
    for gate in gates:
        summary = summarise_ensemble(gate)
        if summary.score != "action_l2":
            continue
        over = summary.over_pairs
        cells = [
            summary.label,
            "shared" if summary.shared_noise else "private",
            *(number(over[name].mean, ".4f") for name in ("obs", "delta", "delta_pooled", "capacity")),
            _ranged(over["rho"], ".1%"),
            number(over["valid_rate"].mean, ".4f"),
        ]
        rows.append((*cells, *_crn(gate, summary.shared_noise)))
    columns = (
        Column("ensemble", text=True),
        Column("noise", "shared: all members start from one draw; private: each from its own", text=True),
        Column("mismatch", "observed: how often two members choose different modes"),
        Column("Δ", "how much less often than chance they do, condition by condition"),
        Column("Δ pooled", "the same over all conditions' counts together (the paper's accounting here)"),
        Column("C", "how much less often they could"),
        Column(f"{RHO} [pairs]", "Δ / C; in brackets the range over pairs of members"),
        Column("valid", "share of sampled pairs in which both members reach a mode"),
        Column("paper: mismatch", "tab:crn, an ensemble of the same objectives of the paper's own network"),
        Column("paper: Δ pooled"),
        Column("paper: valid"),
    )
    note = "Means over pairs of members."
    return Table("Do the members of an ensemble choose modes together?", columns, tuple(rows), notes=(note,))


def contamination_table(gates: Sequence[Gate]) -> Table:
    """The share of every score that members in different modes contribute, beside the paper's."""
    rows = []
    for gate in gates:
        summary = summarise_ensemble(gate)
        over = summary.over_pairs
        share, auroc = _paper_scores(gate, summary.score, summary.shared_noise)
        rows.append(
            (
                summary.label,
                SCORES.get(summary.score, summary.score),
                "shared" if summary.shared_noise else "private",
                f"{summary.pairs:,}",
                summary.unit if summary.unit != "1" else "",
                number(over["mean"].mean, ".4g"),
                number(over["same"].mean, ".4g"),
                _ranged(over["cross_share"], ".1%"),
                _ranged(over["auroc"], ".3f"),
                share,
                auroc,
            )
        )
    columns = (
        Column("ensemble", text=True),
        Column(
            "score", "what compares two members; VFD at one member's states, with its time weight or without", text=True
        ),
        Column("noise", text=True),
        Column("samples", "per condition and member"),
        Column("unit", text=True),
        Column("mean", "of all both-valid pairs of samples"),
        Column("same-mode", "of those in one mode: what is left when no one chooses another way"),
        Column("cross-mode share [pairs]", "of the score's sum that members in two modes contribute: contamination"),
        Column("AUROC [pairs]", "of the score as a detector of two modes, within conditions"),
        Column("paper: share", "sec:vfd, app:mechtables"),
        Column("paper: AUROC"),
    )
    note = "Means over pairs of members, in brackets their range."
    return Table("What is an ensemble's disagreement made of?", columns, tuple(rows), notes=(note,))


def _crn(gate: Gate, shared: bool) -> tuple[str, str, str]:
    row = paper_ensemble(gate)
    printed = _printed("tab:crn", f"v2/ensemble {row} shared x0")
    if row is None or not printed:
        return "-", "-", "-"
    if not shared:
        # The paper prints nothing but the valid-pair rate of private noise.
        return "-", "-", _value(printed.get("valid_pair_rate_uncoupled"), ".4f")
    cells = (("obs", ".4f"), ("delta_pooled", "+.4f"), ("valid_pair_rate", ".4f"))
    first, second, third = (_value(printed.get(name), spec) for name, spec in cells)
    return first, second, third


def _paper_scores(gate: Gate, score: str, shared: bool) -> tuple[str, str]:
    """The paper's share and AUROC of a score."""
    row = paper_ensemble(gate)
    if row is None or (score == "action_l2" and shared):
        return "-", "-"
    if score == "action_l2":
        return _value(_printed("sec:vfd", _ACTION_L2_PRIVATE).get("cross_mode_share"), ".1%"), "-"
    printed = _printed("app:mechtables", f"v2/vfd ensemble {row}/{'weighted' if score == 'vfd' else 'unweighted'}")
    return _value(printed.get("cross_mode_share"), ".1%"), _value(printed.get("auroc"), ".3f")


def _printed(source: str, row: str) -> dict[str, PaperNumber]:
    return {p.quantity: p for p in paper_numbers() if (p.source, p.row) == (source, row)}


def _value(printed: PaperNumber | None, spec: str) -> str:
    if printed is None:
        return "-"
    value = "" if printed.value is None else format(printed.value, spec)
    if printed.low is None or printed.high is None:
        return value
    return f"{value} {_range(printed.low, printed.high, spec)}".strip()


def _ranged(over: OverPairs, spec: str) -> str:
    if over.mean != over.mean:
        return "undefined"
    return f"{over.mean:{spec}} {_range(over.low, over.high, spec)}"


def _range(low: float, high: float, spec: str) -> str:
    if not spec.endswith("%"):
        return f"[{low:{spec}},{high:{spec}}]"
    spec = spec.replace("%", "f")
    return f"[{100 * low:{spec}},{100 * high:{spec}}]"
