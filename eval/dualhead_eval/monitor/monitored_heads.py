"""The monitored heads themselves: do they coordinate where two modes are open, and could they disagree at all?

Whether coordination takes false alarms away can be asked only of heads that have both modes at their disposal: the
certificate's capacity on flagged decisions says so. It rides along with the scores and never raises an alarm.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from dualhead_eval.certificate.certificate import CoordinationCertificate
from dualhead_eval.monitor.decision import Episode


def certified(episodes: Iterable[Episode], certificate: CoordinationCertificate, held_pairs: int) -> Iterator[Episode]:
    """The episodes as they are, after their fresh pairs have been fed to ``certificate``.

    Args:
        episodes: Episodes with mode labels.
        certificate: The certificate; it sees flagged decisions, or all where nothing is flagged.
        held_pairs: How many first pairs follow what the episode holds, and are no fresh draws.
    """
    for episode in episodes:
        for decision in episode.decisions:
            if decision.labels is not None and decision.flagged is not False:
                fresh = decision.labels[:, held_pairs:]
                if fresh.shape[1]:
                    certificate.update(fresh[:1], fresh[1:])
        yield episode


def describe(certificate: CoordinationCertificate) -> dict[str, Any]:
    """What the certificate says, as JSON keeps it; None where a number is not defined."""
    reading = certificate.reading
    numbers = {"delta": reading.delta, "capacity": reading.capacity, "rho": reading.rho}
    numbers["valid_rate"] = reading.valid_rate
    return {
        "verdict": reading.occupancy.word if reading.occupancy else reading.verdict,
        "reason": reading.reason,
        "decisions": reading.decisions,
        **{name: value if value == value else None for name, value in numbers.items()},
        "capacity_bounds": [reading.bounds["capacity"].low, reading.bounds["capacity"].high],
    }
