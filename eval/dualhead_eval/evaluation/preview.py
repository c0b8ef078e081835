"""A contact sheet of an evaluation: what both heads predict under the first conditions, drawn into the scene."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from dualhead_eval.atomic_text import write_bytes
from dualhead_eval.evaluation.conditions import ConditionBank
from dualhead_eval.evaluation.decision_pictures import decided, under_line
from dualhead_eval.evaluation.films import open_filmed
from dualhead_eval.evaluation.protocol import EvaluationProtocol
from dualhead_eval.evaluation.samplers import EvaluatedSampler

#: Conditions on the sheet, how many side by side, and pairs drawn under each.
CONDITIONS, COLUMNS, PAIRS = 6, 3, 24


def write_preview(
    sampler: EvaluatedSampler, conditions: ConditionBank, protocol: EvaluationProtocol, path: Path
) -> None:
    """Write the sheet as a PNG.

    Args:
        sampler: What is evaluated.
        conditions: Its conditions, of which the first are shown.
        protocol: Its steps, seed and coupling; a sheet draws fewer pairs.
        path: The file to write.

    Raises:
        ValueError: If sampler and conditions have different layouts, or pictures need an OpenGL that is not there.
    """
    sampler.require_conditions(conditions)
    bank = conditions[slice(0, CONDITIONS)]
    env: Any = open_filmed(bank.provenance["dataset"]["env_id"], bank.env_kwargs, "the dataset").unwrapped
    samples = sampler.sample(bank, PAIRS, protocol.reference_nfe, protocol.coupling, protocol.seed)
    first = sampler.kinematics.position(samples.joint.double()).cpu().numpy()
    second = samples.position.double().cpu().numpy()
    pictures = []
    for row, condition in enumerate(bank.state):
        shown = decided(first[row], second[row], condition, bank.partition)
        state = bank.observation["observation.state"][row]
        picture = env.picture_of({"agent_pos": state, "environment_state": condition}, shown.ribbons)
        pictures.append(under_line(picture, f"pair {bank.pair_ids[row]}", shown.words, shown.heads))
    env.close()
    while len(pictures) % COLUMNS:
        pictures.append(np.full_like(pictures[0], 255))
    rows = [np.concatenate(pictures[at : at + COLUMNS], axis=1) for at in range(0, len(pictures), COLUMNS)]
    buffer = io.BytesIO()
    Image.fromarray(np.concatenate(rows)).save(buffer, format="PNG", optimize=True)
    write_bytes(path, buffer.getvalue())
