"""Workers end with the process that started them, even if that is killed without a word."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

from dualhead_envs.worker_processes import interrupts_kept_from_workers

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
