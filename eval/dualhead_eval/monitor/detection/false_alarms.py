"""False alarms per decision of successful episodes: where two modes are open, elsewhere, and their difference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualhead_eval.monitor.detection.alarm_log import AlarmLog

#: Columns of :attr:`FalseAlarms.counts`.
COLUMNS = ("flagged", "flagged_alarms", "other", "other_alarms", "one_sided", "one_sided_alarms")
#: Rates that follow from them.
RATES = ("flagged", "other", "gap", "surcharge")


@dataclass(frozen=True)
class FalseAlarms:
    """Counts per episode; failed episodes have none.

    Attributes:
        counts: Decisions and alarms ``(E, 6)``, see :data:`COLUMNS`.
    """

    counts: NDArray[np.float64]

    def rates(self, weights: NDArray[np.float64] | None = None) -> dict[str, NDArray[np.float64]]:
        """Rates from all episodes, or for every row of ``weights`` over episodes ``(draws, E)``.

        Returns:
            ``flagged`` and ``other``: share of decisions with an alarm; ``gap`` their difference; ``surcharge`` the
            flagged share minus that of flagged decisions whose executed pair lies on one side: what the mismatch of the
            heads adds to branches being harder. NaN where there is no such decision.
        """
        sums = self.counts.sum(axis=0) if weights is None else weights @ self.counts

        def share(alarms: str, decisions: str) -> NDArray[np.float64]:
            top, bottom = (sums[..., COLUMNS.index(name)] for name in (alarms, decisions))
            return np.divide(top, bottom, out=np.full(np.shape(bottom), np.nan), where=bottom > 0)

        flagged, other = share("flagged_alarms", "flagged"), share("other_alarms", "other")
        one_sided = share("one_sided_alarms", "one_sided")
        return {"flagged": flagged, "other": other, "gap": flagged - other, "surcharge": flagged - one_sided}


def false_alarms(log: AlarmLog, signal: str) -> FalseAlarms:
    """Count the false alarms of one signal.

    Raises:
        ValueError: If the decisions are not flagged.
    """
    counts = np.zeros((len(log.document.episodes), len(COLUMNS)))
    for row, episode, alarm in zip(counts, log.document.episodes, log.exceeded(signal), strict=True):
        if not episode.success:
            continue
        if episode.flagged is None:
            raise ValueError(
                f"the decisions of {log.label} are not flagged, expected scores made with --flag-data: score them "
                "again with the training split that says where two modes are open"
            )
        flagged = np.array(episode.flagged)
        one_sided = flagged & ~np.array(episode.crossed if episode.crossed is not None else [True] * len(flagged))
        for index, group in enumerate((flagged, ~flagged, one_sided)):
            row[2 * index : 2 * index + 2] = group.sum(), (group & alarm).sum()
    return FalseAlarms(counts)
