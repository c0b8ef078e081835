"""The paper's training setting (sec:models), and in what a run departs from it."""

from __future__ import annotations

from typing import Any

from dualhead_eval.statistics.training_record import TrainingRecord

#: The paper's settings by what they are about: field of the configuration, or of the training run, to its value.
PAPER_SETTING: dict[str, dict[str, Any]] = {
    "network": {
        "preconditioning": "none",
        "conditioning": "concat",
        "velocity_layers": 4,
        "velocity_width": 256,
        "encoder_dim": 256,
    },
    "noise on observations": {"observation_noise": 0.0},
    "padding": {"padded_steps": 0},
    "learning rate": {"optimizer_lr": 3e-4, "lr_schedule": "constant"},
    "batch size": {"batch_size": 128},
    "steps": {"steps": 50_000},
}
#: The answer where no departure is known.
NOTHING = "nothing known"


def departures(training: TrainingRecord) -> str:
    """In what a run's training departs from the paper's, in words; `NOTHING` where nothing does.

    What a gate does not say is passed over; a reference was not trained at all.
    """
    if training.reference:
        return "not trained"
    known = {**training.network, "batch_size": training.batch_size, "steps": training.steps}
    names = [
        name
        for name, setting in PAPER_SETTING.items()
        if any(known.get(field, value) not in (None, value) for field, value in setting.items())
    ]
    return ", ".join(names) or NOTHING
