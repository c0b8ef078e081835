"""The representation maps: how head A writes the ring's point (paper, appendix "Testbed").

Head A, the joint head, models ``g^-1`` of the path; ``g`` is :meth:`RepresentationMap.to_position`. All maps
work on the last axis, in float64, and return a position to itself.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

_OVERLAP = re.compile(r"overlap([+]0|[+-][1-9]\d?)")
_ROTATION = re.compile(r"rotation([+]0|[+-][1-9]\d{0,2})")
_POLAR = re.compile(r"polar_([1-9]\d{0,2})_(0|[1-9]\d{0,2})")


class RepresentationMap(Protocol):
    """A map ``g`` from head A's space of ``width`` numbers to the position in the plane."""

    @property
    def name(self) -> str: ...

    @property
    def width(self) -> int: ...

    def to_position(self, representation: ArrayLike) -> np.ndarray:
        """Positions (..., 2) in metres of ``representation`` (..., width): ``g``."""

    def from_position(self, position: ArrayLike) -> np.ndarray:
        """Representation (..., width) of ``position`` (..., 2) in metres: ``g^-1``, or a left inverse."""


@dataclass(frozen=True)
class LinearMap:
    """``from_position(p) = matrix p``, undone by its transpose: the columns of ``matrix`` are orthonormal.

    Attributes:
        name: Name in layouts, datasets and checkpoints.
        matrix: The (width, 2) matrix from positions to the representation.
    """

    name: str
    matrix: np.ndarray = field(repr=False)

    @property
    def width(self) -> int:
        return self.matrix.shape[0]

    def to_position(self, representation: ArrayLike) -> np.ndarray:
        return _last_axis(representation, self.width, self.name) @ self.matrix

    def from_position(self, position: ArrayLike) -> np.ndarray:
        return _last_axis(position, 2, "position") @ self.matrix.T


@dataclass(frozen=True)
class PolarMap:
    """A twist and a stretch: radius to radius^0.7, angle to angle + 0.6 x radius of the position."""

    name: str = "polar"
    exponent: float = 0.7
    twist: float = 0.6
    width: int = 2

    def to_position(self, representation: ArrayLike) -> np.ndarray:
        values = _last_axis(representation, 2, self.name)
        radius = np.hypot(values[..., 0], values[..., 1]) ** (1.0 / self.exponent)
        return _from_polar(radius, np.arctan2(values[..., 1], values[..., 0]) - self.twist * radius)

    def from_position(self, position: ArrayLike) -> np.ndarray:
        values = _last_axis(position, 2, "position")
        radius = np.hypot(values[..., 0], values[..., 1])
        angle = np.arctan2(values[..., 1], values[..., 0]) + self.twist * radius
        return _from_polar(radius**self.exponent, angle)


def _reflection(phi: float) -> np.ndarray:
    """The reflection [[cos 2phi, sin 2phi], [sin 2phi, -cos 2phi]]."""
    return np.array([[math.cos(2 * phi), math.sin(2 * phi)], [math.sin(2 * phi), -math.cos(2 * phi)]])


def _rotation(angle: float) -> np.ndarray:
    """The rotation by ``angle`` radians: both heads' deciding projections correlate at its cosine."""
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def _lift(overlap: float) -> np.ndarray:
    """The 6 x 2 lift W = [overlap I; sqrt(1 - overlap^2) I; 0], for which W^T W = I."""
    return np.vstack([overlap * np.eye(2), math.sqrt(1 - overlap**2) * np.eye(2), np.zeros((2, 2))])


def _from_polar(radius: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def _last_axis(values: ArrayLike, width: int, name: str) -> np.ndarray:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != width:
        raise ValueError(f"{name} has shape {array.shape}, expected (..., {width}) for this map")
    return array


class RepresentationMaps(Mapping[str, RepresentationMap]):
    """The representation maps by name: the testbed's three, and families of which every member has a name of its own.

    ``overlap+40`` is the null-space lift with overlap 0.40 (percent, -99 to 99), ``rotation+45`` the rotation by 45
    degrees (-180 to 180), ``polar_70_60`` the polar map with exponent 0.70 and twist 0.60. Iteration is over the
    testbed's three alone.

    >>> maps = RepresentationMaps()
    >>> list(maps), "overlap-35" in maps, "overlap+100" in maps
    (['orthogonal', 'polar', 'nullspace'], True, False)
    """

    #: What a message says of the families.
    FAMILIES = "overlap+40, rotation+45, polar_70_60 and their like"

    def __init__(self) -> None:
        named: list[RepresentationMap] = [
            LinearMap("orthogonal", _reflection(phi=0.0)), PolarMap(), LinearMap("nullspace", _lift(overlap=-0.35)),
        ]  # fmt: skip
        self._named = {one.name: one for one in named}

    def __getitem__(self, name: str) -> RepresentationMap:
        found = self._named.get(name) or _family_member(name)
        if found is None:
            raise KeyError(name)
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self._named)

    def __len__(self) -> int:
        return len(self._named)


def _family_member(name: str) -> RepresentationMap | None:
    """The member of a family that ``name`` is, None if it is none; each map has one name there."""
    if match := _OVERLAP.fullmatch(name):
        return LinearMap(name, _lift(int(match[1]) / 100))
    if (match := _ROTATION.fullmatch(name)) and abs(int(match[1])) <= 180:
        return LinearMap(name, _rotation(math.radians(int(match[1]))))
    if match := _POLAR.fullmatch(name):
        return PolarMap(name, exponent=int(match[1]) / 100, twist=int(match[2]) / 100)
    return None


#: Every representation by name; ``overlap`` of the null-space lift is -0.35.
REPRESENTATION_MAPS = RepresentationMaps()


def representation_map(name: str) -> RepresentationMap:
    """The map called ``name``.

    Raises:
        ValueError: If there is none.
    """
    if name not in REPRESENTATION_MAPS:
        raise ValueError(
            f"representation={name!r} is not one of {sorted(REPRESENTATION_MAPS)} for the ring, nor of the families "
            f"{REPRESENTATION_MAPS.FAMILIES}: choose one of these"
        )
    return REPRESENTATION_MAPS[name]
