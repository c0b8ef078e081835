"""The schema of a gate file's content: what each field may hold, before the gate's own consistency is checked."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from dualhead_envs.validated_json import Label, Schema

Size = Annotated[int, Field(ge=0, le=10**9)]
#: Counts of samples: every integer up to here is exact as a float, too.
Count = Annotated[int, Field(ge=0, le=2**53)]


class Counts(Schema):
    """An array of counts, flat."""

    shape: Annotated[list[Size], Field(max_length=20)]
    values: list[Count]


class Numbers(Schema):
    """An array of numbers, flat; None stands for NaN."""

    shape: Annotated[list[Size], Field(max_length=20)]
    values: list[float | None]


class PackedStrata(Schema):
    """:class:`dualhead_eval.residuals.strata.ResidualStrata`, flat."""

    unit: Literal["mm", "deg", "1"]
    n: Counts
    total: Numbers
    squares: Numbers
    median: Numbers
    u: Numbers


class GateContent(Schema):
    """The fields of :class:`dualhead_eval.gate.gate.Gate`, arrays flat."""

    heads: Annotated[list[Label], Field(min_length=2, max_length=16)]
    n_modes: Annotated[int, Field(ge=2, le=1000)]
    taus: Annotated[list[float], Field(max_length=1000)]
    nfes: Annotated[list[int], Field(max_length=1000)]
    reference_tau: float
    reference_nfe: int
    counts: Counts
    conditions: Numbers
    pair_ids: Counts
    target_probabilities: list[float] | None
    provenance: dict[str, Any]
    strata: dict[Label, PackedStrata]
