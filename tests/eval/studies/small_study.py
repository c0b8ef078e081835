"""A study of a tiny ring, and the command that runs it in a folder."""

from __future__ import annotations

from pathlib import Path

import yaml

STUDY = {
    "title": "Shared noise on a small ring",
    "question": "Does shared noise do what the map says?",
    "datasets": {
        "ring": {
            "env": "RotatingRing-v2",
            "env_kwargs": {"representation": "nullspace"},
            "episodes": 400,
            "conditions": 12,
        }
    },
    "banks": {
        "frozen": {"conditions": 6, "pairs": 64},
        "large": {"conditions": 12, "pairs": 32, "residuals": False},
    },
    "flags": {"policy.velocity_width": 64, "policy.encoder_dim": 32, "policy.device": "cpu"},
    "runs": [
        {
            "importance": 1,
            "configurations": [
                {"name": "A_independent", "flags": {"policy.source_noise_beta": 1.0}},
                {"name": "B_shared_noise", "flags": {"policy.source_noise_beta": 0.0}},
            ],
            "seeds": [0, 1],
            "steps": 150,
            "evaluate_at": [50, 150],
            "closed_loops": {"rows": ["A_independent"], "controls": ["joint", "position"], "episodes": 3},
        },
        {
            "importance": 2,
            "configurations": [
                {"name": "A_independent", "flags": {"policy.source_noise_beta": 1.0}},
                {"name": "B_shared_noise", "flags": {"policy.source_noise_beta": 0.0}},
            ],
            "resampled": [
                {"name": "B_in_sampling", "of": "A_independent", "source_noise_beta": 0.0},
                {"name": "one_head", "of": "B_shared_noise", "draws": "position"},
            ],
            "seeds": [0, 1],
            "steps": 150,
            "banks": ["large"],
        },
    ],
    "criteria": [
        {
            "name": "floor",
            "test": "equivalence",
            "claim": "Independent heads are at the floor.",
            "criterion": "seed-level TOST of rho at 2 %",
            "rows": ["A_independent"],
            "margin": 0.02,
        },
        {
            "name": "optimum",
            "test": "exact",
            "claim": "Networks reach the optimum.",
            "criterion": "within 3 points",
            "rows": ["A_independent", "B_shared_noise"],
            "margin": 0.03,
        },
        {
            "name": "driving",
            "test": "closed_loop",
            "claim": "Either head drives by every way.",
            "criterion": "Wilson's lower ends",
            "rows": ["A_independent"],
            "at_least": 0.9,
            "each_way_at_least": 0.8,
        },
    ],
}


def write_study(folder: Path, **changes) -> Path:
    path = folder / "small.yaml"
    path.write_text(yaml.safe_dump(STUDY | changes, sort_keys=False))
    return path


def command(folder: Path, *more: str, study: Path | None = None) -> list[str]:
    places = ["--data", str(folder / "data"), "--runs", str(folder / "runs"), "--results", str(folder / "results")]
    return ["study", str(study or folder / "small.yaml"), *places, "--jobs", "1", "--no-progress", *more]


def contents(folder: Path) -> dict[Path, tuple[int, bytes]]:
    return {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in folder.rglob("*") if path.is_file()}
