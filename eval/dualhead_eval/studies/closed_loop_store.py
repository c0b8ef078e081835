"""The closed loops of studies: which are recorded, and what became of their episodes.

Of a recording a study keeps its description (``meta/dualhead.json``), which holds every episode's outcome; the
recording itself stays beside the training runs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dualhead_envs.dataset_sidecar import SIDECAR
from dualhead_eval.atomic_text import write_bytes
from dualhead_eval.evaluation.rollouts import ClosedLoop, closed_loop_of, read_outcomes
from dualhead_eval.gate.compressed import compress
from dualhead_eval.studies.gate_identity import refuse_other_loop, wanted_policy
from dualhead_eval.studies.study_plan import StudyLoop, StudyPlan


@dataclass(frozen=True)
class LoopResult:
    """One closed loop of a study.

    Attributes:
        loop: What was asked for.
        outcome: What became of its episodes.
    """

    loop: StudyLoop
    outcome: ClosedLoop

    @property
    def name(self) -> str:
        """Cell, seed and driving head."""
        return f"{self.loop.run.cell} seed {self.loop.run.seed}, {self.loop.control} head"


class ClosedLoopStore:
    """Outcomes in one folder, as :attr:`StudyLoop.file` names them.

    Args:
        folder: Where they lie.
    """

    def __init__(self, folder: str | Path):
        self.folder = Path(folder)

    def path(self, loop: StudyLoop) -> Path:
        """Where the outcomes of a closed loop lie, or belong."""
        return self.folder / loop.file

    def missing(self, plan: StudyPlan) -> list[StudyLoop]:
        """Closed loops without outcomes, in the plan's order."""
        return [loop for loop in plan.loops if not self.path(loop).is_file()]

    def results(self, plan: StudyPlan) -> list[LoopResult]:
        """The closed loops of a plan that are there, each held against what the plan asks for.

        Raises:
            ValueError: If a file is damaged, or of another policy, environment or number of episodes.
        """
        return [
            LoopResult(loop, _outcome(self._read(self.path(loop), plan, loop)))
            for loop in plan.loops
            if self.path(loop).is_file()
        ]

    def keep(self, recording: Path, plan: StudyPlan, loop: StudyLoop) -> None:
        """Keep the outcomes of a recording.

        Raises:
            ValueError: If it is damaged, or not the closed loop that the plan asks for.
        """
        sidecar = self._read(recording / SIDECAR, plan, loop)
        write_bytes(self.path(loop), compress(json.dumps(sidecar, separators=(",", ":"))))

    def _read(self, path: Path, plan: StudyPlan, loop: StudyLoop) -> Mapping[str, Any]:
        sidecar = read_outcomes(path)
        refuse_other_loop(sidecar, loop, plan.datasets[loop.run.dataset], wanted_policy(loop.run), source=path)
        return sidecar


def _outcome(sidecar: Mapping[str, Any]) -> ClosedLoop:
    outcome = closed_loop_of(sidecar)
    assert outcome is not None
    return outcome
