"""What an arm's alarms do in one cell: threshold, false alarms where two modes are open and elsewhere, intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.monitor.detection.comparison import percentile_interval
from dualhead_eval.monitor.thresholds.threshold import conformal_quantile
from dualhead_eval.statistics.interval import Interval
from dualhead_eval.studies.monitor.regimes.heads import Drawn

#: Flagged decisions by what their pair does: (on one side, on two) x (alarm, none).
_GROUPS = 4


@dataclass(frozen=True)
class Estimate:
    """A number and its bootstrap replicates ``(draws,)``; independent estimates subtract."""

    value: float
    replicates: NDArray[np.float64]

    @property
    def interval(self) -> Interval:
        """95 % percentile interval."""
        return percentile_interval(self.replicates)

    def __sub__(self, other: Estimate) -> Estimate:
        return Estimate(self.value - other.value, self.replicates - other.replicates)

    def __rmul__(self, factor: float) -> Estimate:
        return Estimate(factor * self.value, factor * self.replicates)


@dataclass(frozen=True)
class Outcome:
    """Alarms of one arm in one cell.

    Attributes:
        threshold: In mm.
        floor: Threshold in mm that the other test decisions alone would have.
        flagged: Share of flagged test decisions with an alarm.
        other: Share of other test decisions with an alarm.
        gap: Flagged less other.
        surcharge: Flagged less those flagged ones whose pair lies on one side.
    """

    threshold: float
    floor: float
    flagged: float
    other: float
    gap: Estimate
    surcharge: Estimate


def outcome(
    calibration: NDArray[np.float64], flagged: Drawn, other: Drawn, *, alpha: float, draws: int,
    rng: np.random.Generator,
) -> Outcome:  # fmt: skip
    """Calibrate and count, with a bootstrap over calibration, flagged and other decisions.

    The k-th smallest of a resample of n scores is their order statistic at n times a Beta(k, n + 1 - k) number, and the
    counts of a resample at a threshold are multinomial: the bootstrap's own distribution, without resampling.

    Args:
        calibration: Residuals ``(n,)`` in mm of calibration decisions.
        flagged: Flagged test decisions.
        other: Other test decisions.
        alpha: Rate of false alarms.
        draws: Bootstrap replicates.
        rng: Their randomness.
    """
    ordered = np.sort(calibration)
    threshold = conformal_quantile(ordered, alpha)
    rank = np.searchsorted(ordered, threshold, side="left") + 1
    places = (ordered.size * rng.beta(rank, ordered.size + 1 - rank, size=draws)).astype(np.int64)
    thresholds = ordered[np.minimum(places, ordered.size - 1)]

    shares = _group_shares(flagged, np.array([threshold]))[0]
    counts = rng.multinomial(len(flagged.residual), _group_shares(flagged, thresholds)) / len(flagged.residual)
    elsewhere = _share_beyond(other.residual, np.array([threshold]))[0]
    elsewhere_drawn = rng.binomial(len(other.residual), _share_beyond(other.residual, thresholds)) / len(other.residual)
    rate, surcharge = _flagged_rates(shares)
    rates_drawn, surcharges_drawn = _flagged_rates(counts)
    return Outcome(
        threshold=threshold,
        floor=conformal_quantile(other.residual, alpha),
        flagged=float(rate),
        other=float(elsewhere),
        gap=Estimate(float(rate - elsewhere), rates_drawn - elsewhere_drawn),
        surcharge=Estimate(float(surcharge), surcharges_drawn),
    )


def _share_beyond(values: NDArray[np.float64], thresholds: NDArray[np.float64]) -> NDArray[np.float64]:
    return 1 - np.searchsorted(np.sort(values), thresholds, side="right") / values.size


def _group_shares(drawn: Drawn, thresholds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shares ``(draws, 4)`` of all decisions: on one side with an alarm, without; on two sides with, without."""
    shares = np.zeros((thresholds.size, _GROUPS))
    for place, group in enumerate((~drawn.crossed, drawn.crossed)):
        size = group.mean()
        if size:
            beyond = size * _share_beyond(drawn.residual[group], thresholds)
            shares[:, 2 * place], shares[:, 2 * place + 1] = beyond, size - beyond
    return shares / shares.sum(axis=1, keepdims=True)


def _flagged_rates(shares: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Share of alarms, and its surcharge over pairs on one side; NaN where there are none."""
    one_sided, rate = shares[..., 0] + shares[..., 1], shares[..., 0] + shares[..., 2]
    alone = np.divide(shares[..., 0], one_sided, out=np.full(np.shape(one_sided), np.nan), where=one_sided > 0)
    return rate, rate - alone
