"""Workers end with the process that started them, even if that is killed without a word."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from joblib import Parallel, delayed

from dualhead_envs.worker_processes import interrupts_kept_from_workers, workers_ended_afterwards

WORKER = """
import os, time
from dualhead_envs.worker_processes import end_with
end_with(os.getppid())
print(os.getpid(), flush=True)
time.sleep(120)
"""
PARENT = "import subprocess, sys; subprocess.run([sys.executable, '-c', sys.argv[1]])"


def is_alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_a_worker_ends_after_its_parent_was_killed():
    with subprocess.Popen([sys.executable, "-c", PARENT, WORKER], stdout=subprocess.PIPE, text=True) as parent:
        worker = int(parent.stdout.readline())
        assert is_alive(worker)
        parent.send_signal(signal.SIGKILL)
    deadline = time.monotonic() + 60
    while is_alive(worker) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_alive(worker)


def test_joblibs_workers_are_gone_after_their_work_and_come_back_for_more():
    for _ in range(2):
        with workers_ended_afterwards():
            workers = set(Parallel(2, backend="loky")(delayed(os.getpid)() for _ in range(4)))
        assert os.getpid() not in workers
        assert not any(map(is_alive, workers))


def test_joblibs_workers_are_gone_after_an_error():
    workers = []

    def work_and_fail():
        workers.extend(Parallel(2, backend="loky")(delayed(os.getpid)() for _ in range(2)))
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"), workers_ended_afterwards():
        work_and_fail()
    assert not any(map(is_alive, workers))


def test_ctrl_c_reaches_the_parent_and_not_what_it_starts_meanwhile():
    sleep = [sys.executable, "-c", "import sys; print(flush=True); sys.stdin.read()"]
    with (
        interrupts_kept_from_workers(),
        subprocess.Popen(sleep, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as worker,
    ):
        worker.stdout.readline()
        worker.send_signal(signal.SIGINT)
        worker.stdin.close()
        assert worker.wait() == 0
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
