"""What a sweep has, and what it lacks."""

from __future__ import annotations

from pathlib import Path

from dualhead_policy.training.sweep.manifest import Manifest


def sweep_lines(folder: Path, manifest: Manifest) -> list[str]:
    """One line on a sweep as a whole, and one per run that is missing."""
    missing = manifest.unfinished()
    lines = [f"Sweep {folder}: {len(manifest.runs) - len(missing)} of {len(manifest.runs)} runs finished."]
    for name, record in missing.items():
        state = f"failed: {record.error}" if record.state == "failed" else "repeat `dualhead sweep` to go on"
        lines.append(f"  missing {name}: at step {record.step:,} of {record.steps:,}; {state}")
    return lines
