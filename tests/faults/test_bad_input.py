"""Bad input of every format is refused in one sentence that names it; nothing is believed, nothing hangs.

    uv run pytest -m slow tests/faults/test_bad_input.py

runs every case and prints the figures; a sample of them runs with every test.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import signal
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import pytest
from bad_input import all_cases
from cases import Case, Products

from dualhead_eval.cli import TRACEBACK, main

#: A command that still works on bad input after this many seconds of processor time, or six times as many of waiting,
#: hangs.
HANG_SECONDS = 20.0
#: A line of tqdm, or the terminal control that rich writes with its bars.
PROGRESS = re.compile(r"^\s*$|\d+%\||\d+/\d+ ?\[|━")


class HangError(BaseException):
    """Raised in a command that takes too long; not an Exception, so that no handler takes it for its own."""


@dataclass(frozen=True)
class Outcome:
    """What a command made of bad input.

    Attributes:
        kind: ``"refused"``, as it should; ``"vague"``: refused, but not in one sentence that names the input;
            ``"accepted"``; ``"traceback"``; or ``"hang"``.
        text: What it wrote to standard error.
    """

    kind: str
    text: str


def run_case(case: Case, folder: Path) -> Outcome:
    """Run a case in this process, in an empty folder."""
    errors, status, began = io.StringIO(), 0, time.process_time()
    with (
        contextlib.chdir(folder),
        _alarm(),
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(errors),
    ):
        try:
            status = main(case.prepare(folder))
        except SystemExit as exit_:
            status = int(exit_.code or 0)
        except HangError:
            return Outcome("hang", errors.getvalue())
        except BaseException:  # whatever leaves the error door is the finding
            return Outcome("traceback", traceback.format_exc())
    lines = [line for line in re.split(r"[\r\n]", errors.getvalue()) if not PROGRESS.search(line)]
    text = "\n".join(lines)
    if time.process_time() - began > HANG_SECONDS:
        return Outcome("hang", text)
    if "unexpected error" in text:
        return Outcome("traceback", text)
    if status == 0:
        return Outcome("accepted", text)
    # argparse writes how a command is used before its sentence.
    sentences = [line for line in lines if ": error:" in line]
    used = len(sentences) == len(lines) or lines[0].startswith("usage: ")
    named = bool(sentences) and any(word in sentences[0] for word in case.mentions)
    whole = len(sentences) == 1 and used and named and sentences[0].isprintable()
    return Outcome("refused" if whole else "vague", text)


@contextlib.contextmanager
def _alarm() -> Iterator[None]:
    def ring(*_: object) -> None:
        raise HangError

    timers = {
        signal.SIGPROF: (signal.ITIMER_PROF, HANG_SECONDS),
        signal.SIGALRM: (signal.ITIMER_REAL, 6 * HANG_SECONDS),
    }
    before = {number: signal.signal(number, ring) for number in timers}
    for timer, seconds in timers.values():
        signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        for number, (timer, _) in timers.items():
            signal.setitimer(timer, 0)
            signal.signal(number, before[number])


@pytest.fixture(scope="module")
def products(ring_data, trained, lerobot_runs, tmp_path_factory) -> Products:
    folder = tmp_path_factory.mktemp("products")
    gate = folder / "run.gate.json"
    scan = ["--pairs", "20", "--conditions", "3", "--nfe", "20", "10", "--tau", "0.4", "--label", "a run"]
    assert main(["evaluate", "--exact", "--dataset", str(ring_data / "test"), *scan, "--output", str(gate)]) == 0
    partition = {"name": "ring", "n_modes": 2, "tau": 0.55, "parameters": {}}
    rollouts = {
        "format": "dualhead-rollouts/1", "env_id": "RotatingRing-v2", "env_kwargs": {"control": "joint"},
        "layout": "ring/nullspace", "horizon": 16, "samples": 2, "num_inference_steps": 20, "seed": 0,
        "partition": partition, "policy": {"training_step": 10},
        "outcomes": [{"seed": i, "success": i < 2, "collision": False, "mode": 0} for i in range(3)],
    }  # fmt: skip
    (folder / "loop.rollouts.json").write_text(json.dumps(rollouts))
    return Products(ring_data, trained, gate, folder / "loop.rollouts.json", lerobot_runs["act"])


def complaint(case: Case, outcome: Outcome) -> str:
    return f"{outcome.kind}: {case.name}\n    {outcome.text[-1500:]}"


def test_whole_products_are_read(products, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["report", str(products.gate), str(products.rollouts), str(products.data)]) == 0
    data = ["--dataset", str(products.data / "test"), "--pairs", "2", "--conditions", "2"]
    assert main(["evaluate", "--policy", str(products.run), *data, "--output", "out.gate.json"]) == 0
    assert main(["evaluate", "--policy", str(products.act), *data, "--output", "act.gate.json"]) == 0


#: Formats that a command reads in a fraction of a second; `dualhead train` takes seconds to parse its flags.
QUICK = ("gate", "rollouts", "card", "data", "meta/info.json", "meta/dualhead.json", "config.json", "model.safetensors")
QUICK += ("act config.json", "act policy_preprocessor", "act model.safetensors")
QUICK += ("policy_preprocessor", "policy_postprocessor", "command: 'evaluate", "command: 'report", "command: 'record")


def test_a_sample_of_bad_input_is_refused(products, tmp_path):
    quick = [case for case in all_cases(products) if case.name.startswith(QUICK)]
    found = []
    for number, case in enumerate(quick[7::25]):
        folder = tmp_path / str(number)
        folder.mkdir()
        outcome = run_case(case, folder)
        if outcome.kind != "refused":
            found.append(complaint(case, outcome))
    assert not found, "\n".join(found)


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_all_bad_input_is_refused(products, tmp_path, monkeypatch):
    monkeypatch.delenv(TRACEBACK, raising=False)
    outcomes: dict[str, Outcome] = {}
    cases = list(all_cases(products))
    wanted = os.environ.get("DUALHEAD_FAULTS", "")
    for number, case in enumerate(cases):
        if wanted not in case.name:
            continue
        folder = tmp_path / str(number)
        folder.mkdir()
        outcomes[case.name] = run_case(case, folder)
        assert not (folder / "it-ran").exists(), f"{case.name} ran a program"
    found = [complaint(case, outcomes[case.name]) for case in cases if outcomes.get(case.name, OK).kind != "refused"]
    for family, group in groupby(sorted(outcomes, key=_family), key=_family):
        print(f"{family:45}", dict(Counter(outcomes[name].kind for name in group)))
    print("bad input:", len(outcomes), dict(Counter(outcome.kind for outcome in outcomes.values())))
    assert not found, "\n".join(found)
    assert wanted or len(outcomes) >= 500


OK = Outcome("refused", "")


def _family(name: str) -> str:
    return name.partition(":")[0]
