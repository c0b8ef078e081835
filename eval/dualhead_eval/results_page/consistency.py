"""Endpoint consistency: trained runs beside the optimum of their loss, and the optimum over its weight."""

from __future__ import annotations

from collections.abc import Sequence

from dualhead_eval.paper.mechanism import Mechanism, mechanism_of
from dualhead_eval.paper.numbers import paper_row
from dualhead_eval.report.table import number
from dualhead_eval.results_page.folders import NamedRun, named_runs, rho_with_interval
from dualhead_eval.results_page.template import markdown_table, percent

#: G's weight, and the folder of the optima.
G_WEIGHT = 3.0
OPTIMA = "results/optimum"
MAPS = ("nullspace", "orthogonal", "polar")


def consistency_table(arguments: list[str]) -> str:
    """``consistency ENVIRONMENT FOLDER[=NOTE] ...``: the paper's G, ours, and the optimum of its loss.

    Raises:
        ValueError: If no environment is named.
    """
    if not arguments or arguments[0] not in ("v2", "v3"):
        raise ValueError("the table of consistency is about v2 or v3, expected one of these and folders")
    environment, *folders = arguments
    rows = [_paper_line(environment)]
    rows += [_line(named) for named in named_runs(folders) if _is_g(named, environment)]
    rows += [_line(named, optimum=True) for named in _optima(environment) if _is_g(named, environment)]
    return markdown_table([f"G on {environment}, lambda 3, shared noise", "steps", "valid", "rho", "residual mm"], rows)


def optimum_table(arguments: list[str]) -> str:
    """``optimum``: rho of the robots' optima over lambda, a line for each environment and beta, and the paper's."""
    _refuse(arguments)
    optima = [named for environment in ("v2", "v3") for named in _optima(environment)]
    weights = sorted({mechanism_of(named.run.gate).consistency for named in optima})
    keys = list(dict.fromkeys((named.environment, mechanism_of(named.run.gate).beta) for named in optima))
    rows = []
    for environment, beta in sorted(keys):
        own = {
            mechanism_of(named.run.gate).consistency: named
            for named in optima
            if (named.environment, mechanism_of(named.run.gate).beta) == (environment, beta)
        }
        most = max(named.run.gate.n_conditions for named in optima if named.environment == environment)
        rows.append([f"{environment}, beta {beta:g}", *(_optimum_cell(own.get(weight), most) for weight in weights)])
        printed = [_paper_rho(own[weight]) if weight in own else None for weight in weights]
        if any(value is not None for value in printed):
            rows.append(
                [f"{environment}, beta {beta:g}, the paper", *(percent(v) if v is not None else "" for v in printed)]
            )
    return markdown_table(["rho", *(f"lambda {weight:g}" for weight in weights)], rows)


def ladder_table(arguments: list[str]) -> str:
    """``ladder FOLDER``: the ring's ladder of lambda, map by map: optimum, trained runs of the folder, paper."""
    trained = {_ring_key(named): named for named in named_runs(arguments) if _is_ladder(named)}
    optima = {_ring_key(named): named for named in named_runs([OPTIMA]) if _is_ladder(named)}
    weights = sorted({weight for _, weight in {**trained, **optima}})
    columns, with_runs = ["lambda"], [name for name in MAPS if any(key[0] == name for key in trained)]
    for name in MAPS:
        columns += [f"{name}, optimum", *(["trained"] if name in with_runs else []), "paper"]
    rows = []
    for weight in weights:
        row = [f"{weight:g}"]
        for name in MAPS:
            optimum, run = optima.get((name, weight)), trained.get((name, weight))
            row.append("" if optimum is None else optimum.rho)
            if name in with_runs:
                row.append("" if run is None else run.rho)
            either = optimum or run
            value = None if either is None else _paper_rho(either)
            row.append("" if value is None else percent(value))
        rows.append(row)
    return markdown_table(columns, rows)


def _refuse(arguments: Sequence[str]) -> None:
    if arguments:
        raise ValueError(f"this table takes no arguments, {' '.join(arguments)!r} was given")


def _optima(environment: str) -> list[NamedRun]:
    return [named for named in named_runs([OPTIMA]) if named.environment == environment]


def _is_g(named: NamedRun, environment: str) -> bool:
    mechanism = mechanism_of(named.run.gate)
    plain = mechanism.token is None and mechanism.latent is None and mechanism.standard
    own = (mechanism.environment, mechanism.beta, mechanism.consistency) == (environment, 0.0, G_WEIGHT)
    return bool(plain and own)


def _is_ladder(named: NamedRun) -> bool:
    mechanism = mechanism_of(named.run.gate)
    # tab:maps is about two equally likely modes, and a folder may hold others under the same map.
    place = mechanism.environment == "testbed" and mechanism.n_modes == 2 and mechanism.standard
    return place and mechanism.beta == 0 and mechanism.consistency > 0


def _ring_key(named: NamedRun) -> tuple[str, float]:
    mechanism: Mechanism = mechanism_of(named.run.gate)
    return mechanism.representation, mechanism.consistency


def _paper_rho(named: NamedRun) -> float | None:
    printed = paper_row(mechanism_of(named.run.gate).paper_row).get("rho")
    return None if printed is None else printed.value


def _paper_line(environment: str) -> list[str]:
    printed = paper_row(f"{environment}/G consistency " + ("beta0 lambda3" if environment == "v2" else "lambda3"))
    value = {
        name: printed[name].value if name in printed else None for name in ("valid_pair_rate", "rho", "residual_mm")
    }
    seeds = printed["rho"].n if "rho" in printed else None
    name = "the paper" + (f" ({seeds} seeds)" if seeds else "")
    return [
        name,
        "50,000",
        number(value["valid_pair_rate"], ".3f"),
        percent(value["rho"]),
        number(value["residual_mm"], ".1f"),
    ]


def _line(named: NamedRun, *, optimum: bool = False) -> list[str]:
    name = "**the optimum**" if optimum else named.name.removeprefix(f"{named.environment} ")
    run = named.run
    return [
        name,
        "" if optimum else named.steps,
        f"{run.first.valid_rate:.3f}",
        named.rho,
        number(run.residual_mm, ".1f"),
    ]


def _optimum_cell(named: NamedRun | None, most: int) -> str:
    if named is None:
        return ""
    own = named.run.gate.n_conditions
    return rho_with_interval(named.run) + ("" if own == most else f" ({own} conditions)")
