"""A two-sided interval that may be undefined."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Interval:
    """A two-sided interval; NaN bounds where it is undefined, with the number of undefined replicates.

    Attributes:
        low: Lower bound.
        high: Upper bound.
        level: Nominal coverage.
        undefined: Replicates in which the statistic was undefined.
    """

    low: float
    high: float
    level: float
    undefined: int = 0

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high

    @property
    def largest_magnitude(self) -> float:
        """max(|low|, |high|): the margin-free width d-hat of sec:tost."""
        return float(max(abs(self.low), abs(self.high)))
