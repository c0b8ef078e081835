"""Scores of many policies on one log, a file each, several processes at a time."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from joblib import Parallel, delayed, parallel_config

from dualhead_envs.worker_processes import end_with, interrupts_kept_from_workers
from dualhead_eval.studies.monitor.registration import Scoring
from dualhead_policy.sampling import SamplingCoupling


@dataclass(frozen=True)
class ScoreJob:
    """A policy to score.

    Attributes:
        policy: Its folder.
        target: The file to write.
        seed: Its training seed.
        coupling: What its heads share; None: as they were trained.
    """

    policy: Path
    target: Path
    seed: int
    coupling: SamplingCoupling | None = None


def score_files(
    log: Path,
    jobs: Sequence[ScoreJob],
    scoring: Scoring,
    *,
    workers: int = 1,
    device: str = "cpu",
    progress: Callable[[int], object] | None = None,
) -> None:
    """Score policies.

    Args:
        log: The log's file.
        jobs: The policies.
        scoring: How they are scored.
        workers: Processes at a time.
        device: Where the policies are sampled.
        progress: Called with 1 after every policy.
    """
    with parallel_config(backend="loky", initializer=end_with, initargs=(os.getpid(),)):
        parallel = Parallel(n_jobs=workers, return_as="generator_unordered", batch_size=1, pre_dispatch="all")
        with interrupts_kept_from_workers():
            done = parallel(delayed(score_file)(log, job, scoring, device) for job in jobs)
        for _ in done:
            if progress is not None:
                progress(1)


def score_file(log: Path, job: ScoreJob, scoring: Scoring, device: str) -> None:
    """Score one policy and write its file."""
    import torch

    from dualhead_eval.evaluation.protocol import coupling_provenance
    from dualhead_eval.studies.monitor.log_table import read_log
    from dualhead_eval.studies.monitor.scoring import score_arm
    from dualhead_policy.pretrained import load_policy, policy_folder
    from dualhead_policy.quiet import quiet_libraries
    from dualhead_policy.training.provenance import policy_provenance

    quiet_libraries()
    torch.set_num_threads(1)
    policy, preprocess = load_policy(job.policy, device=device)
    scored = score_arm(
        read_log(log),
        policy,
        preprocess,
        samples=scoring.samples,
        seed=(scoring.seed, job.seed),
        signals=scoring.signals,
        provenance=policy_provenance(policy, policy_folder(job.policy)) | coupling_provenance(job.coupling),
        coupling=job.coupling,
    )
    scored.write(job.target)
