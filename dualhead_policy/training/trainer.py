"""Train one policy: ``lerobot-train``'s loop with the windows in memory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from lerobot.common.train_utils import load_training_state, should_save_checkpoint
from lerobot.configs.train import TrainPipelineConfig
from lerobot.optim.factory import make_optimizer_and_scheduler
from lerobot.policies import make_policy
from lerobot.utils.constants import CHECKPOINTS_DIR, PRETRAINED_MODEL_DIR, TRAINING_STATE_DIR
from lerobot.utils.random_utils import set_seed

from dualhead_envs.dataset_frames import SplitFrames, read_split
from dualhead_policy.configuration_dualhead import DualheadConfig
from dualhead_policy.flow.loss import flow_loss
from dualhead_policy.hub_folder import processor_folder
from dualhead_policy.modeling_dualhead import MEASURE_EVERY, DualheadPolicy
from dualhead_policy.processor_dualhead import make_dualhead_pre_post_processors
from dualhead_policy.processor_loading import load_processors
from dualhead_policy.training.array_store import ArrayStore
from dualhead_policy.training.batch import Batch
from dualhead_policy.training.checkpoints import (
    WindowOrigin,
    checkpoint_folder,
    naming_what_stands,
    point_last_at,
    stage_checkpoint,
    window_origin,
    write_checkpoint,
)
from dualhead_policy.training.dataset_metadata import open_metadata
from dualhead_policy.training.fresh_ring_paths import FreshRingPaths
from dualhead_policy.training.recorded_windows import RecordedWindows
from dualhead_policy.training.run_folder import clear_false_start
from dualhead_policy.training.training_log import LOG_FILE, TrainingLog

Progress = Callable[[int, float], None]


class Training:
    """A training run: policy, optimiser and data, ready to make steps.

    Args:
        cfg: A validated LeRobot training configuration with a ``dualhead`` policy.
        fresh_paths: Draw new ring paths at every step instead of visiting the recorded windows. A resumed run goes on
            as it began.

    Raises:
        ValueError: If the policy is of another type, or the dataset does not suit it.
    """

    def __init__(self, cfg: TrainPipelineConfig, *, fresh_paths: bool = False):
        if not isinstance(cfg.policy, DualheadConfig):
            raise ValueError(
                f"--policy.type={cfg.policy.type if cfg.policy else None} is not 'dualhead': use lerobot-train for "
                "other policies"
            )
        _refuse_what_is_not_done(cfg)
        self.cfg = cfg
        seed = cfg.seed if cfg.seed is not None else 0
        set_seed(seed)
        frames = read_split(cfg.dataset.root or "")
        meta = open_metadata(cfg.dataset.repo_id, frames)
        # Resuming and fine-tuning load weights, and LeRobot announces each on standard output.
        policy = make_policy(cfg.policy, ds_meta=meta)
        assert isinstance(policy, DualheadPolicy)
        self.policy = policy.train()
        if cfg.policy.pretrained_path:
            origin = processor_folder(cfg.policy.pretrained_path, cfg.policy.pretrained_revision)
            self.processors = load_processors(origin, cfg.policy)
        else:
            self.processors = make_dualhead_pre_post_processors(cfg.policy, meta.stats)
        self.optimizer, self.scheduler = make_optimizer_and_scheduler(cfg, self.policy)
        for group in self.optimizer.param_groups:
            group["fused"] = True
        self.step = 0
        #: Steps at which a checkpoint is due besides those of ``save_freq``.
        self.save_at: frozenset[int] = frozenset()
        if cfg.resume:
            assert cfg.checkpoint_path is not None
            self._resume(cfg.checkpoint_path)
            fresh_paths = self._resumed_source(cfg.checkpoint_path, frames, fresh_paths)
        self.origin = WindowOrigin(frames.fingerprint, fresh_paths)
        self.source: RecordedWindows | FreshRingPaths
        if fresh_paths:
            self.source = self._fresh_paths(frames.sidecar, seed)
        else:
            self.source = RecordedWindows(frames, self.policy, self.processors[0], cfg.batch_size, seed)

    def _resume(self, checkpoint: Path) -> None:
        """Load optimiser, schedule, random state and step, which must be those of the checkpoint's policy."""
        remedy = "resume from another checkpoint, or train again"
        try:
            self.step, self.optimizer, self.scheduler = load_training_state(checkpoint, self.optimizer, self.scheduler)
        # LeRobot passes on what its files' readers and torch raise.
        except Exception as error:
            raise ValueError(
                f"{checkpoint / TRAINING_STATE_DIR} is damaged ({type(error).__name__} while loading it): {remedy}"
            ) from error
        if self.step != int(self.policy.training_step):
            raise ValueError(
                f"{checkpoint / TRAINING_STATE_DIR} is of step {self.step}, its policy of step "
                f"{int(self.policy.training_step)}, expected the same: {remedy}"
            )

    def _resumed_source(self, checkpoint: Path, frames: SplitFrames, fresh_paths: bool) -> bool:
        """Whether the run that wrote ``checkpoint`` drew fresh paths; refuses other data than it began with."""
        began = window_origin(checkpoint) or WindowOrigin(frames.fingerprint)
        if began.dataset != frames.fingerprint:
            raise ValueError(
                f"{frames.root} holds other data (SHA-256 {frames.fingerprint[:12]}...) than {checkpoint} was trained "
                f"on ({began.dataset[:12]}...): resume with the data that the run began with, or start a new run from "
                f"its weights with --policy.path={checkpoint / PRETRAINED_MODEL_DIR}"
            )
        if fresh_paths and not began.fresh_paths:
            raise ValueError(
                f"{checkpoint} was trained on recorded windows: resume it without --fresh_paths, or start "
                "a new run with it"
            )
        return began.fresh_paths

    def _fresh_paths(self, sidecar: dict[str, Any], seed: int) -> FreshRingPaths:
        if not sidecar.get("env_id", "").startswith("RotatingRing-v"):
            raise ValueError(
                f"--fresh_paths draws from the ring's generator, but the dataset was recorded from "
                f"{sidecar.get('env_id', 'an unknown environment')}: leave it out"
            )
        return FreshRingPaths(
            sidecar["env_kwargs"],
            sidecar["partition"]["n_modes"],
            self.policy,
            self.processors[0],
            self.cfg.batch_size,
            seed,
        )

    def update(self, batch: Batch) -> tuple[float, float]:
        """One optimiser step; returns the loss, and the flow-matching losses' share of it."""
        loss, parts = self.policy.compute_loss(batch.observation, batch.action, batch.token)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.policy.parameters(), self.grad_clip_norm)
        self.optimizer.step()
        self.optimizer.zero_grad()
        self.advance()
        return loss.item(), flow_loss(parts).item()

    def advance(self, steps: int = 1) -> None:
        """Count optimiser steps that have been made."""
        if self.scheduler is not None:
            # LeRobot's schedules are functions of the step alone: the last of these steps sets the rate.
            self.scheduler.last_epoch += steps - 1
            self.scheduler._step_count += steps - 1
            self.scheduler.step()
        self.policy.training_step += steps
        self.step += steps

    def rate(self, step: int) -> float:
        """Learning rate of training step ``step``."""
        if self.scheduler is None:
            return self.optimizer.param_groups[0]["lr"]
        return self.scheduler.base_lrs[0] * self.scheduler.lr_lambdas[0](step)

    @property
    def grad_clip_norm(self) -> float:
        """Largest gradient norm; what exceeds it is scaled down."""
        assert self.cfg.optimizer is not None
        return self.cfg.optimizer.grad_clip_norm

    def share_windows(self, store: ArrayStore) -> None:
        """Hold the recorded windows in ``store``, so that many runs hold them once."""
        if isinstance(self.source, RecordedWindows):
            self.source.share(store)

    def save(self) -> Path:
        """Write a checkpoint of the current step; returns its ``pretrained_model`` folder."""
        return write_checkpoint(*self._checkpoint())

    def stage(self) -> Path:
        """Assemble a checkpoint of the current step; returns the place that it has once it is published."""
        stage_checkpoint(*self._checkpoint())
        return checkpoint_folder(self.cfg, self.step)

    def _checkpoint(self) -> tuple[Any, ...]:
        return self.cfg, self.step, self.policy, self.optimizer, self.scheduler, self.processors, self.origin

    def begin(self) -> TrainingLog:
        """Prepare the run's folder for the steps to come; returns its log."""
        cfg = self.cfg
        assert cfg.output_dir is not None
        output = Path(cfg.output_dir)
        if cfg.resume:
            assert cfg.checkpoint_path is not None
            if cfg.checkpoint_path.parent.resolve() == (output / CHECKPOINTS_DIR).resolve():
                point_last_at(cfg.checkpoint_path)  # later checkpoints belong to a future that is given up
        else:
            clear_false_start(output)
        with naming_what_stands(output, output / LOG_FILE):
            return TrainingLog(output / LOG_FILE, self.step)

    def saves_now(self) -> bool:
        """Whether a checkpoint is due at the current step."""
        due = self.step in self.save_at or should_save_checkpoint(self.step, self.cfg.save_freq, self.cfg.steps)
        return self.cfg.save_checkpoint and due

    def run(self, progress: Progress | None = None) -> Path:
        """Train to the configured number of steps, saving on the way.

        Args:
            progress: Called after every step with the step and its loss.

        Returns:
            The final checkpoint's ``pretrained_model`` folder.

        Raises:
            ValueError: If the loss stops being finite.
            OSError: If the disk is full; the last complete checkpoint stands.
        """
        cfg = self.cfg
        assert cfg.output_dir is not None
        output = Path(cfg.output_dir)
        log_file = output / LOG_FILE
        if cfg.resume and self.step >= cfg.steps:
            assert cfg.checkpoint_path is not None
            return cfg.checkpoint_path / PRETRAINED_MODEL_DIR
        log = self.begin()
        rate = self.policy.config.optimizer_lr
        saved: Path | None = None
        while self.step < cfg.steps:
            batch = self.source.batch(self.step)
            if self.step % MEASURE_EVERY == 0:
                log.measure(self.policy.measure(batch.observation, batch.action, batch.token))
            loss, flow = self.update(batch)
            if loss != loss:
                raise ValueError(
                    f"the loss is not a number at step {self.step}: lower policy.optimizer_lr (now {rate}) and "
                    "start again"
                )
            with naming_what_stands(output, log_file):
                log.add(self.step, loss, flow)
            if progress is not None:
                progress(self.step, loss)
            if self.saves_now():
                with naming_what_stands(output, log_file):
                    log.flush(self.step)
                saved = self.save()
        return saved or self.save()


def _refuse_what_is_not_done(cfg: TrainPipelineConfig) -> None:
    """Refuse settings of ``lerobot-train`` that this trainer would otherwise pass over."""
    for name, number, least in (
        ("steps", cfg.steps, 1),
        ("batch_size", cfg.batch_size, 1),
        ("save_freq", cfg.save_freq, 1),
        ("seed", cfg.seed or 0, 0),
    ):
        if number < least:
            raise ValueError(f"--{name}={number} is too small: give at least {least}")
    given = {
        "dataset.episodes": cfg.dataset.episodes,
        "dataset.eval_split": cfg.dataset.eval_split or None,
        "dataset.streaming": cfg.dataset.streaming or None,
        "sample_weighting": cfg.sample_weighting,
    }
    for name, value in given.items():
        if value is not None:
            raise ValueError(
                f"--{name}={value} is not an option of `dualhead train`, which trains on every window of "
                "--dataset.root: leave it out, give a root that holds the episodes alone, or use lerobot-train"
            )
