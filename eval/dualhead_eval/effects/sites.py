"""Sites of the attainable region: one table of thresholds and words for reports and certificates.

The paper names four sites (sec:main-tables). Its only stated thresholds are those of the high-capacity corner
(sec:toy-occupancy: rho >= 85% and C >= 0.80 max C) and the equivalence margin of 2%; the bound on "near the
origin" is ours, set between its collapsed runs (relative capacity up to 0.125) and its lowest floor cell
(0.248). Capacity is examined first: where it is small, rho compares two numbers that are both nearly zero.

A report knows a point (C, rho) and asks :func:`occupancy`; a certificate knows bounds and asks
:func:`sites_within`. Both print the words of :class:`Occupancy`.
"""

from __future__ import annotations

from enum import Enum
from math import isnan

Range = tuple[float, float]

#: |rho| up to this is the floor: the equivalence margin of sec:tost.
FLOOR_RHO = 0.02
#: rho from here on is the corner.
CORNER_RHO = 0.85
#: Relative capacity C / (1 - 1/K) that the corner needs.
CORNER_CAPACITY = 0.80
#: Relative capacity below which a run is near the origin.
ORIGIN_CAPACITY = 0.20
#: What the sites are called where the paper speaks of them.
SITE_NAMES = {"I": "floor", "II": "origin", "III": "interior", "IV": "corner", "-": "negative", "?": "unknown"}
#: Valid-pair rate below which rho describes too few of the pairs to be read.
MIN_VALID_RATE = 0.50
#: The same for partitions of which more is asked. On the ring every expert path is valid, so invalid samples mean an
#: under-trained sampler, whose survivors inflate |rho|; on the robots they are ordinary.
READABLE_VALID_RATE = {"ring": 0.95}


def readable_valid_rate(partition: str) -> float:
    """Valid-pair rate below which rho is not read under the mode partition of this name."""
    return READABLE_VALID_RATE.get(partition, MIN_VALID_RATE)


class Occupancy(Enum):
    """Site in the (C, Delta) plane: the paper's number, a certificate's verdict, the degree, what it means."""

    FLOOR = ("I", "uncoordinated", "", "the heads choose modes independently")
    ORIGIN = ("II", "collapsed", "", "the heads agree because they barely vary")
    INTERIOR = ("III", "coordinated", "in part", "the heads agree more than chance, less than they could")
    CORNER = ("IV", "coordinated", "in full", "the heads choose the same mode and keep every mode alive")
    NEGATIVE = ("-", "anti-coordinated", "", "the heads avoid each other's mode")
    UNKNOWN = ("?", "insufficient", "", "too few valid pairs for any effect")

    @property
    def site(self) -> str:
        """The paper's class, I to IV; ``-`` below the floor, ``?`` where nothing is estimable."""
        return self.value[0]

    @property
    def verdict(self) -> str:
        """The verdict of a certificate whose bounds lie inside this site."""
        return self.value[1]

    @property
    def word(self) -> str:
        """The verdict with its degree, for a table cell: ``"coordinated in part"``."""
        return f"{self.verdict} {self.value[2]}".rstrip()

    @property
    def meaning(self) -> str:
        """What the class says about the two heads."""
        return self.value[3]


def occupancy(rho: float, capacity: float, n_modes: int) -> Occupancy:
    """Site of a run with normalised effect ``rho`` (NaN where capacity is zero) and ``capacity``.

    >>> occupancy(0.2, 0.4, n_modes=2).word, occupancy(0.0, 0.05, n_modes=2).word
    ('coordinated in part', 'collapsed')
    """
    if isnan(capacity):
        return Occupancy.UNKNOWN
    if isnan(rho):
        return Occupancy.ORIGIN
    (site,) = sites_within((rho, rho), (capacity, capacity), n_modes)
    return site


def sites_within(
    rho: Range, capacity: Range, n_modes: int, *, floor: float = FLOOR_RHO, origin: float = ORIGIN_CAPACITY
) -> frozenset[Occupancy]:
    """Sites that hold at least one point (C, rho) of a box.

    Args:
        rho: Lower and upper bound on the normalised effect.
        capacity: Lower and upper bound on the capacity C.
        n_modes: Number of modes K.
        floor: Largest |rho| of the floor.
        origin: Relative capacity below which a point is near the origin.
    """
    low, high = (c / (1 - 1 / n_modes) for c in capacity)
    found = set()
    if low < origin:
        found.add(Occupancy.ORIGIN)
    if high >= origin:
        if rho[0] < -floor:
            found.add(Occupancy.NEGATIVE)
        if rho[0] <= floor and rho[1] >= -floor:
            found.add(Occupancy.FLOOR)
        if rho[1] > floor and (rho[0] < CORNER_RHO or low < CORNER_CAPACITY):
            found.add(Occupancy.INTERIOR)
        if rho[1] >= CORNER_RHO and high >= CORNER_CAPACITY:
            found.add(Occupancy.CORNER)
    return frozenset(found)
