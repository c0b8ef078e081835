"""``dualhead evaluate --record --monitor``: a fitted monitor beside the episodes that are recorded."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dualhead_eval.evaluation.decisions import Decider
    from dualhead_eval.monitor.recording_watch import RecordedMonitor


def open_monitor(
    folder: Path, decisions: Decider, layout: str, env_id: str, env_kwargs: dict[str, Any], state_names: list[str]
) -> RecordedMonitor:
    """A fitted monitor that reads what a policy decides in an environment.

    Raises:
        FileNotFoundError: If there is no monitor.
        ValueError: If it was fitted for another layout, horizon or number of pairs, or needs flagged decisions.
    """
    from dualhead_eval.evaluation.conditions import environment_partition
    from dualhead_eval.monitor.monitor_file import load_monitor, require_layout
    from dualhead_eval.monitor.recording_watch import RecordedMonitor

    monitor, document = load_monitor(folder)
    if "joint" not in decisions.widths:
        raise ValueError("the policy has no two heads to compare, expected a dual-head policy: leave --monitor out")
    require_layout(document, {"layout": layout, "horizon": decisions.horizon}, "the policy")
    samples = decisions.samples
    if document.samples != samples:
        raise ValueError(
            f"{folder} was fitted on {document.samples} pairs per decision and {samples} are recorded, expected the "
            f"same: give --samples {document.samples}"
        )
    if monitor.threshold_name.startswith("mondrian"):
        raise ValueError(
            f"{folder} has a Mondrian threshold, which needs flagged decisions: fit one with another threshold"
        )
    partition = environment_partition(env_id, env_kwargs, str(folder))
    return RecordedMonitor(monitor, layout, state_names, env_kwargs["control"], partition)
