"""Which part of the attainable region a run occupies, in words (paper: sec:main-tables).

The paper names four sites. Its only stated thresholds are those of the high-capacity corner
(sec:toy-occupancy: rho >= 85% and C >= 0.80 max C) and the equivalence margin of 2%; the bound on "near the
origin" is ours, set between its collapsed runs (relative capacity up to 0.125) and its lowest floor cell
(0.248).
"""

from __future__ import annotations

from enum import Enum
from math import isnan

#: |rho| up to this is the floor: the equivalence margin of sec:tost.
FLOOR_RHO = 0.02
#: rho from here on is the corner or the boundary near the origin.
CORNER_RHO = 0.85
#: Relative capacity C / (1 - 1/K) that the corner needs.
CORNER_CAPACITY = 0.80
#: Relative capacity below which a run is near the origin.
ORIGIN_CAPACITY = 0.20
#: What the sites are called where the paper speaks of them.
SITE_NAMES = {"I": "floor", "II": "origin", "III": "interior", "IV": "corner", "-": "negative", "?": "unknown"}


class Occupancy(Enum):
    """Site in the (C, Delta) plane: the paper's number, and what it means."""

    FLOOR = ("I", "uncoordinated", "the heads choose modes independently")
    ORIGIN = ("II", "collapsed", "the heads agree because they barely vary")
    INTERIOR = ("III", "partly coordinated", "the heads agree more than chance, less than they could")
    CORNER = ("IV", "coordinated", "the heads choose the same mode and keep both modes alive")
    NEGATIVE = ("-", "anti-coordinated", "the heads avoid each other's mode")
    UNKNOWN = ("?", "not estimable", "too few valid pairs for any effect")

    @property
    def site(self) -> str:
        """The paper's class, I to IV; ``-`` below the floor, ``?`` where nothing is estimable."""
        return self.value[0]

    @property
    def word(self) -> str:
        """One or two words for a table cell."""
        return self.value[1]

    @property
    def meaning(self) -> str:
        """What the class says about the two heads."""
        return self.value[2]


def occupancy(rho: float, capacity: float, n_modes: int) -> Occupancy:
    """Class of a run with normalised effect ``rho`` (NaN where capacity is zero) and ``capacity``."""
    if isnan(capacity):
        return Occupancy.UNKNOWN
    relative = capacity / (1 - 1 / n_modes)
    if isnan(rho):
        return Occupancy.ORIGIN
    if abs(rho) <= FLOOR_RHO:
        return Occupancy.FLOOR
    if rho < 0:
        return Occupancy.NEGATIVE
    if relative < ORIGIN_CAPACITY:
        return Occupancy.ORIGIN
    if rho >= CORNER_RHO and relative >= CORNER_CAPACITY:
        return Occupancy.CORNER
    return Occupancy.INTERIOR
