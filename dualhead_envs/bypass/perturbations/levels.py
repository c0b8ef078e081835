"""Severities of the four levels of every kind, mildest first."""

from __future__ import annotations

Levels = tuple[float, float, float, float]

_PILOT: dict[str, Levels] = {
    "cube_bias": (0.02, 0.025, 0.03, 0.035),
    "joint_bias": (0.03, 0.045, 0.06, 0.07),
    "noise": (0.015, 0.022, 0.03, 0.035),
    "push": (75.0, 130.0, 180.0, 240.0),
    "slip": (4, 5, 6, 7),
    "delay": (1, 1, 2, 2),
    "payload": (3.0, 5.0, 8.0, 12.0),
    "friction": (0.3, 0.2, 0.15, 0.1),
    "obstacle": (0.05, 0.06, 0.07, 0.08),
    "goal": (0.04, 0.045, 0.05, 0.055),
}

#: By environment and kind.
LEVELS: dict[str, dict[str, Levels]] = {"BimodalBypass-v2": _PILOT, "RotatingBypass-v3": _PILOT}
