"""Partitions as JSON: a file names one of the kinds that need no code, and the numbers that it is built from.

    {"name": "side", "tau": 0.1, "parameters": {"normal": [0, 1, 0]}}

That is what ``to_dict`` writes. A file never names code.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, RootModel

from dualhead_envs.validated_json import Schema, read_validated, validated
from dualhead_eval.partitions.crossing import CrossingPartition
from dualhead_eval.partitions.nearest import EndpointPartition, ReferencePartition
from dualhead_eval.partitions.partition import PathPartition
from dualhead_eval.partitions.side import SidePartition

REMEDY = "see docs/your_own_task.md for what each kind takes"
Vector = Annotated[list[float], Field(min_length=1, max_length=64)]
Points = Annotated[list[Vector], Field(min_length=1, max_length=10_000)]


class SideParameters(Schema):
    """Of :class:`dualhead_eval.partitions.side.SidePartition`."""

    normal: Vector
    point: Vector | None = None


class CrossingParameters(Schema):
    """Of :class:`dualhead_eval.partitions.crossing.CrossingPartition`."""

    normal: Vector
    across: Vector
    point: Vector | None = None
    boundaries: Annotated[tuple[float, ...], Field(min_length=1, max_length=999)] = (0.0,)


class ReferenceParameters(Schema):
    """Of :class:`dualhead_eval.partitions.nearest.ReferencePartition`."""

    references: Annotated[list[Points], Field(min_length=2, max_length=1000)]


class EndpointParameters(Schema):
    """Of :class:`dualhead_eval.partitions.nearest.EndpointPartition`."""

    centers: Annotated[list[Vector], Field(min_length=2, max_length=1000)]


class _Partition(Schema):
    tau: float
    #: Follows from the parameters; checked where it is given.
    n_modes: int | None = None


class Side(_Partition):
    """A side of a plane."""

    name: Literal["side"]
    parameters: SideParameters


class Crossing(_Partition):
    """A gap of a waypoint plane."""

    name: Literal["crossing"]
    parameters: CrossingParameters


class Reference(_Partition):
    """The nearest reference path."""

    name: Literal["reference"]
    parameters: ReferenceParameters


class Endpoint(_Partition):
    """The nearest end point."""

    name: Literal["endpoint"]
    parameters: EndpointParameters


class PartitionDescription(RootModel[Annotated[Side | Crossing | Reference | Endpoint, Field(discriminator="name")]]):
    """Any of them, told apart by name."""


#: Partitions that need no code, by name.
KINDS: dict[str, type[PathPartition]] = {
    kind.name: kind for kind in (SidePartition, CrossingPartition, ReferencePartition, EndpointPartition)
}


def build_partition(description: dict[str, Any], *, source: str = "partition") -> PathPartition:
    """The partition that ``to_dict`` described.

    >>> build_partition({"name": "side", "tau": 0.1, "parameters": {"normal": [0, 1, 0]}}).to_dict()["n_modes"]
    2

    Args:
        description: ``name``, ``tau``, ``parameters`` and, to be checked, ``n_modes``.
        source: What is described, for errors.

    Raises:
        ValueError: In one sentence about the first misfit.
    """
    return _build(validated(description, PartitionDescription, source=source, remedy=REMEDY), source)


def read_partition(path: str | Path) -> PathPartition:
    """The partition in a JSON file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: In one sentence about the first misfit.
    """
    found = read_validated(Path(path), PartitionDescription, kind="the description of a partition", remedy=REMEDY)
    return _build(found, str(path))


def _build(description: PartitionDescription, source: str) -> PathPartition:
    found = description.root
    try:
        partition = KINDS[found.name](**found.parameters.model_dump(), tau=found.tau)
    except ValueError as error:
        raise ValueError(f"{source} describes no partition: {error}") from error
    if found.n_modes not in (None, partition.n_modes):
        raise ValueError(
            f"{source} has n_modes={found.n_modes}, its parameters make {partition.n_modes}: correct it or leave it out"
        )
    return partition
