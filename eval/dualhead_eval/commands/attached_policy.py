"""A copy of a policy's folder with one more step in one of its processors."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any


def write_with_step(source: Path, output: Path, processor: str, step: dict[str, Any], place: int) -> None:
    """Write the copy, if it loads as the policy does.

    Args:
        source: A dual-head policy's folder; steps that were attached to this processor before are replaced.
        output: The copy; it must not hold anything.
        processor: File of the processor.
        step: The step as JSON.
        place: Steps of the processor's own before it.

    Raises:
        FileExistsError: If the output holds anything.
        ValueError: If the policy or the step is none.
    """
    from dualhead_envs.recording.staging import publish, staging_folder
    from dualhead_policy.pretrained import load_policy
    from dualhead_policy.processor_loading import ATTACHED

    with staging_folder(output.resolve()) as staging:
        made = staging / "policy"
        shutil.copytree(source, made)
        path = made / processor
        content = json.loads(path.read_text(encoding="utf-8"))
        own = [known for known in content["steps"] if known["registry_name"] not in ATTACHED]
        content["steps"] = [*own[:place], step, *own[place:]]
        path.write_text(json.dumps(content, indent=2), encoding="utf-8")
        load_policy(made)  # what is published can be loaded
        publish(made, output.resolve())
