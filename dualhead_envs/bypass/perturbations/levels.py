"""Severities of the four levels of every kind, mildest first.

Levels shall make a policy fail in about 20, 35, 50 and 60 % of its episodes. ``docs/perturbations.md`` says which are
interpolated between measured cells and which are not calibrated.
"""

from __future__ import annotations

Levels = tuple[float, float, float, float]

_BIMODAL: dict[str, Levels] = {
    "cube_bias": (0.0213, 0.0271, 0.0287, 0.0291),
    "joint_bias": (0.0391, 0.0435, 0.0519, 0.0615),
    "noise": (0.0195, 0.0216, 0.0295, 0.0315),
    "push": (190.0, 491.0, 523.0, 546.0),
    "slip": (5, 5, 6, 6),
    "delay": (1, 1, 2, 2),
    "payload": (3.0, 5.0, 8.0, 12.0),
    "friction": (0.3, 0.2, 0.15, 0.1),
    "obstacle": (0.05, 0.06, 0.07, 0.08),
    "goal": (0.0352, 0.0469, 0.0495, 0.0514),
}

#: By environment and kind.
LEVELS: dict[str, dict[str, Levels]] = {
    "BimodalBypass-v2": _BIMODAL,
    "RotatingBypass-v3": {
        **_BIMODAL,
        "cube_bias": (0.0141, 0.02, 0.0237, 0.0265),
        "joint_bias": (0.0206, 0.0339, 0.0464, 0.0486),
        "noise": (0.013, 0.0165, 0.0199, 0.0225),
    },
}
