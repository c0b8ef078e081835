"""``dualhead monitor``: fit a failure monitor on recorded successes, score recorded episodes, report the detection."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dualhead_eval.commands import monitor_attach, monitor_converse, monitor_regimes, monitor_study
from dualhead_eval.commands.counts import require_counts
from dualhead_eval.commands.source_noise import add_source_noise_options, given_source_noise

if TYPE_CHECKING:
    from dualhead_eval.monitor.decision import Episode
    from dualhead_eval.monitor.recorded_episodes import RecordedEpisodes

DESCRIPTION = """\
Runtime failure monitors on recorded rollouts of a two-head policy.

  dualhead evaluate --policy P --dataset D/test --record R/calibration --samples 16 --episodes 200 --output c.gate.json
  dualhead monitor fit R/calibration --signals residual residual_matched --output M
  dualhead monitor score R/nominal R/pushed --monitor M --flag-data D/train --output run.scores.parquet
  dualhead monitor report run.scores.parquet --output report.html

With --policy, fit and score put another policy's predictions on the recorded observations, so that one recording
serves every monitored policy. `dualhead monitor study` runs the registered experiment, `dualhead monitor converse` its
converse, `dualhead monitor regimes` its sweep of regimes on the ring. Signals, thresholds and measures:
docs/monitor.md.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Define the arguments of ``dualhead monitor``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    fit = actions.add_parser("fit", help="fit signals and thresholds on successful episodes")
    score = actions.add_parser("score", help="read recorded episodes with a fitted monitor")
    report = actions.add_parser("report", help="what the scores detect, as tables")
    monitor_attach.add_arguments(actions.add_parser("attach", help="let unmodified LeRobot raise a monitor's alarms"))
    monitor_study.add_arguments(actions.add_parser("study", help="the registered experiment, start to verdict"))
    monitor_converse.add_arguments(
        actions.add_parser("converse", help="two ways that are hardly apart must cost no false alarms")
    )
    monitor_regimes.add_arguments(actions.add_parser("regimes", help="false alarms over regimes, on the ring"))
    for action in (fit, score):
        action.add_argument("rollouts", nargs="+", type=Path, metavar="DIR", help="folders of recorded rollouts")
        action.add_argument("--policy", metavar="DIR", help="monitor this policy instead of the one that drove")
        add_source_noise_options(action.add_argument_group("with --policy (default: as it was trained)"))
        action.add_argument("--samples", type=int, help="with --policy: pairs per decision (default: as recorded)")
        action.add_argument("--seed", type=int, default=0, help="seed of splits, networks and draws (default: 0)")
        action.add_argument(
            "--flag-data", type=Path, metavar="DIR", help="training split that says where two modes are open"
        )
    fit.add_argument(
        "--signals", nargs="+", default=["residual"], metavar="NAME", help="the first one raises the alarm"
    )
    fit.add_argument("--aggregator", default="ewma-max", help="how scores add up over an episode (default: ewma-max)")
    fit.add_argument("--threshold", default="conformal:episode", help="default: conformal:episode")
    fit.add_argument("--alpha", type=float, default=0.05, help="rate of false alarms (default: 0.05)")
    fit.add_argument(
        "--train-data", type=Path, metavar="DIR", help="training split that signals of the observation learn from"
    )
    fit.add_argument(
        "--executed-steps", type=int, default=8, help="steps of a chunk that residual_executed reads (default: 8)"
    )
    fit.add_argument("--only-successes", action="store_true", help="leave failed episodes out instead of refusing them")
    fit.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder of the monitor")
    score.add_argument("--monitor", type=Path, required=True, metavar="DIR", help="a fitted monitor")
    score.add_argument("--output", type=Path, required=True, metavar="FILE", help="*.scores.parquet to write")
    score.add_argument("--overwrite", action="store_true", help="replace the output file if it exists")
    report.add_argument("scores", nargs="+", type=Path, metavar="FILE", help="*.scores.parquet or *.alarm.json.gz")
    report.add_argument("--output", type=Path, metavar="FILE", help="HTML page to write")
    report.add_argument("--alarms", type=Path, metavar="DIR", help="folder for the small *.alarm.json.gz to keep")
    report.add_argument("--draws", type=int, default=2000, help="bootstrap draws (default: 2000)")
    report.add_argument("--overwrite", action="store_true", help="replace output files that exist")


def run(args: argparse.Namespace) -> int:
    """Run one action.

    Raises:
        FileExistsError: If an output exists.
        FileNotFoundError: If an input does not exist.
        ValueError: If an input or option is unusable.
    """
    from dualhead_policy.quiet import quiet_libraries

    quiet_libraries()
    return {
        "fit": _fit,
        "score": _score,
        "report": _report,
        "attach": monitor_attach.run,
        "study": monitor_study.run,
        "regimes": monitor_regimes.run,
        "converse": monitor_converse.run,
    }[args.action](args)


def _fit(args: argparse.Namespace) -> int:
    import numpy as np

    from dualhead_envs.recording.staging import refuse_occupied
    from dualhead_eval.monitor.monitor import Monitor
    from dualhead_eval.monitor.monitor_file import save_monitor
    from dualhead_eval.monitor.recorded_episodes import training_decisions
    from dualhead_eval.monitor.signals.observation import LargestDeviation
    from dualhead_eval.monitor.signals.registry import make_signal
    from dualhead_eval.monitor.signals.residual import ExecutedResidual

    refuse_occupied(args.output)
    made = [
        make_signal(name, **({"steps": args.executed_steps} if name == ExecutedResidual.name else {}))
        for name in args.signals
    ]
    monitor = Monitor(made, args.aggregator, args.threshold)
    recordings = _open(args)
    episodes = [episode for recorded in recordings for episode in _episodes(args, recorded)]
    kept = [episode for episode in episodes if episode.success or not args.only_successes]
    training = training_decisions(args.train_data) if args.train_data else []
    monitor.fit(kept, args.alpha, rng=np.random.default_rng(args.seed), training=training)
    provenance = {
        "rollouts": [str(path) for path in args.rollouts],
        **_monitored(args),
        "seed": args.seed,
        "left_out_failures": len(episodes) - len(kept),
        "train_data": str(args.train_data) if args.train_data else None,
    }
    layout, samples = recordings[0].layout, _samples(args, recordings[0])
    save_monitor(monitor, args.output, layout=layout, samples=samples, provenance=provenance)
    for channel in monitor.channels:
        limits = next(iter(channel.threshold.learned().values()))
        unit = "" if channel.signal.unit == "1" else f" {channel.signal.unit}"
        print(f"{channel.signal.name}: threshold {_brief(limits)}{unit}; {channel.threshold.guarantee}")
        if isinstance(channel.signal, LargestDeviation) and channel.signal.left_out.size:
            constant = ", ".join(recordings[0].names[i] for i in channel.signal.left_out)
            print(f"  left out because they hardly vary: {constant}")
    print(f"monitor: {args.output}, fitted on {len(kept)} episodes")
    return 0


def _score(args: argparse.Namespace) -> int:
    from tqdm import tqdm

    from dualhead_eval.certificate.certificate import CoordinationCertificate
    from dualhead_eval.commands.console import refuse_overwrite
    from dualhead_eval.monitor.monitor_file import load_monitor, require_layout
    from dualhead_eval.monitor.monitored_heads import certified, describe
    from dualhead_eval.monitor.scores_file import score_episodes, write_scores

    refuse_overwrite([args.output], overwrite=args.overwrite)
    monitor, document = load_monitor(args.monitor)
    recordings = _open(args)
    calibrated = {key.rpartition("/")[2] for key in document.calibration}
    for recorded in recordings:
        require_layout(document, recorded.layout, str(recorded.root))
        if _samples(args, recorded) != document.samples:
            raise ValueError(
                f"{recorded.root} has {_samples(args, recorded)} pairs per decision and the monitor was fitted on "
                f"{document.samples}, expected the same: record or sample as many"
            )
        shared = calibrated & {str(seed) for seed in recorded.seeds}
        if shared:
            raise ValueError(
                f"{recorded.root} shares {len(shared)} seeds with the calibration episodes (the first: "
                f"{min(shared)}), expected other initial states: record with another --seed"
            )

    partition = recordings[0].builder.partition
    assert partition is not None
    certificate = CoordinationCertificate(n_modes=partition.n_modes)

    def episodes() -> Iterator[Episode]:
        for recorded in recordings:
            held = 0 if args.policy else int(recorded.sidecar.get("held_pairs") or 0)
            yield from certified(_episodes(args, recorded), certificate, held)

    with tqdm(total=sum(map(len, recordings)), unit="episode", desc="scoring") as bar:
        table = score_episodes(monitor, episodes(), bar.update)
    limits = {c.signal.name: next(iter(c.threshold.learned().values())).tolist() for c in monitor.channels}
    provenance: dict[str, Any] = {
        "aggregator": document.aggregator,
        "threshold": document.threshold,
        "alpha": document.alpha,
        "limits": {name: [x if abs(x) != float("inf") else None for x in values] for name, values in limits.items()},
        "provenance": {
            "monitor": document.model_dump(exclude={"calibration"}),
            "rollouts": [str(path) for path in args.rollouts],
            **_monitored(args),
            "seed": args.seed,
            "heads": describe(certificate),
        },
    }
    write_scores(table, args.output, provenance)
    heads = provenance["provenance"]["heads"]
    where = "where two modes are open" if args.flag_data else "over all decisions"
    print(f"the heads {where}: {heads['verdict']}" + (f" ({heads['reason']})" if heads["reason"] else ""))
    print(f"scores of {table.num_rows} decisions: {args.output}")
    return 0


def _report(args: argparse.Namespace) -> int:
    from dualhead_eval.commands.console import open_console, refuse_overwrite
    from dualhead_eval.monitor.detection.alarm_log import AlarmLog, alarm_log
    from dualhead_eval.monitor.detection.comparison import require_one_monitor
    from dualhead_eval.monitor.scores_file import read_scores
    from dualhead_eval.report.monitor_tables import measure_all, monitor_tables
    from dualhead_eval.report.terminal import render_table

    require_counts(args, "draws")
    labels = [path.name.partition(".")[0] for path in args.scores]
    if len(set(labels)) < len(labels):
        raise ValueError(f"two files have one name ({', '.join(labels)}), expected a name each: rename one")
    kept = [] if args.alarms is None else [args.alarms / f"{label}.alarm.json.gz" for label in labels]
    refuse_overwrite([args.output, *kept], overwrite=args.overwrite)
    logs = []
    for path, label in zip(args.scores, labels, strict=True):
        logs.append(AlarmLog.read(path) if path.suffix in (".json", ".gz") else alarm_log(*read_scores(path), label))
    require_one_monitor(logs)
    measured = measure_all(logs, draws=args.draws)
    tables = monitor_tables(logs, measured, draws=args.draws)
    console = open_console()
    for table in tables:
        console.print(render_table(table))
    for log, path in zip(logs, kept, strict=bool(kept)):
        log.write(path)
        console.print(f"alarms: {path}")
    if args.output is not None:
        from dualhead_eval.atomic_text import write_text
        from dualhead_eval.report.figures.monitor import monitor_figures
        from dualhead_eval.report.monitor_page import monitor_page

        write_text(args.output, monitor_page(tables, monitor_figures(logs, measured)))
        console.print(f"page: {args.output}")
    return 0


def _open(args: argparse.Namespace) -> list[RecordedEpisodes]:
    from dualhead_envs.dataset_frames import read_split
    from dualhead_eval.monitor.branch_flag import BranchFlag
    from dualhead_eval.monitor.recorded_episodes import open_rollouts

    if args.samples is not None and (args.samples < 1 or not args.policy):
        raise ValueError(f"--samples {args.samples} is for --policy and at least 1: leave it out, or give both")
    if given_source_noise(args) is not None and not args.policy:
        raise ValueError(
            "--source-noise-beta and --source-noise-alignment say how --policy is sampled on the recording, and no "
            "policy is given: leave them out, or record with them (`dualhead evaluate --record`)"
        )
    flag: Callable | None = BranchFlag.from_split(read_split(args.flag_data)) if args.flag_data else None
    recordings = [open_rollouts(path, flag=flag) for path in args.rollouts]
    for recorded in recordings[1:]:
        if recorded.layout != recordings[0].layout:
            raise ValueError(
                f"{recorded.root} has the layout {recorded.layout} and {recordings[0].root} {recordings[0].layout}, "
                "expected one robot, horizon and observation: give rollouts of one environment"
            )
    names = [recorded.root.resolve().name for recorded in recordings]
    if len(set(names)) < len(names):
        raise ValueError(f"two folders have one name ({', '.join(names)}), expected a name each: rename one")
    return recordings


def _samples(args: argparse.Namespace, recorded: RecordedEpisodes) -> int:
    return args.samples or recorded.samples


def _episodes(args: argparse.Namespace, recorded: RecordedEpisodes) -> Iterable[Episode]:
    if not args.policy:
        return recorded
    from dualhead_eval.monitor.resampling import resampled_episodes
    from dualhead_policy.pretrained import load_policy

    if not hasattr(args, "loaded"):
        args.loaded = load_policy(args.policy)
    policy, preprocess = args.loaded
    return resampled_episodes(
        recorded,
        policy,
        preprocess,
        samples=_samples(args, recorded),
        seed=args.seed,
        coupling=given_source_noise(args),
    )


def _monitored(args: argparse.Namespace) -> dict[str, Any]:
    """What a file says of the policy that is monitored instead of the one that drove."""
    from dualhead_eval.evaluation.protocol import coupling_provenance

    return {"policy": args.policy} | coupling_provenance(given_source_noise(args))


def _brief(limits: Any) -> str:
    shown = [f"{limit:.4g}" for limit in limits[:3]]
    return ", ".join(shown) + (", ..." if len(limits) > 3 else "")
