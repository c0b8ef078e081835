"""The closed loop of ``dualhead evaluate --record``: a policy acts in the environment of a dataset, and is recorded."""

from __future__ import annotations

import argparse

from dualhead_eval.commands.pictures import require_films
from dualhead_eval.commands.policy_draws import open_decisions
from dualhead_eval.commands.rollout_monitor import open_monitor
from dualhead_eval.commands.source_noise import given_source_noise


def roll_out(args: argparse.Namespace, episodes: int) -> None:
    """Roll the policy out and record it into ``args.record``.

    Raises:
        FileExistsError: If the folder holds anything.
        FileNotFoundError: If there is no policy or dataset.
        ValueError: If an option is unusable, or the policy does not fit the environment.
    """
    from tqdm import tqdm

    from dualhead_envs.dataset_frames import read_split
    from dualhead_eval.evaluation.closed_loop import record_decisions
    from dualhead_eval.evaluation.conditions import recorded_environment

    frames = read_split(args.dataset)
    env_id, env_kwargs = recorded_environment(frames)
    if args.perturb is not None and "Bypass" not in env_id:
        raise ValueError(
            f"--perturb has no meaning in {env_id}: leave it out, only the robot environments are perturbed"
        )
    given = {} if args.perturb is None else {"perturbation": args.perturb}
    env_kwargs = {**env_kwargs, "control": args.control or "joint", **given}
    require_films(args, env_id, env_kwargs)
    samples = 2 if args.samples is None else args.samples
    decisions, provenance = open_decisions(
        args.policy[0], samples, frames.sidecar.get("horizon", 16), given_source_noise(args)
    )
    watch = None
    if args.monitor is not None:
        names = frames.info["features"]["observation.state"]["names"]
        watch = open_monitor(args.monitor, decisions, frames.sidecar["layout"], env_id, env_kwargs, names)
    with tqdm(total=episodes, unit="episode", desc="rolling out", delay=1) as bar:
        loop, verdict = record_decisions(
            decisions,
            args.record,
            env_id=env_id,
            env_kwargs=env_kwargs,
            episodes=episodes,
            seed=0 if args.seed is None else args.seed,
            provenance=provenance,
            watch=watch,
            progress=bar.update,
        )
    for refusal in loop.refusals:
        print(refusal)
    print(f"closed loop, {loop}; recorded in {args.record}\nruntime certificate after these episodes: {verdict}")
