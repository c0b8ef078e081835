"""From an output folder to its staging folder and back, by one process at a time, whole or not at all."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dualhead_envs.recording.claim import claimed, discard
from dualhead_envs.recording.staging import publish, staging_folder

HOLD = """
import sys
from pathlib import Path
from dualhead_envs.recording.staging import staging_folder
with staging_folder(Path(sys.argv[1])) as folder:
    (folder / "half").write_text("half of it")
    print(flush=True)
    input()
"""


def holder(root):
    """Another process that makes ``root`` and has begun to."""
    command = [sys.executable, "-c", HOLD, str(root)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"\n"
    return process


def test_a_product_appears_whole_and_nothing_else_stays(tmp_path):
    root = tmp_path / "out"
    with staging_folder(root) as folder:
        (folder / "product").mkdir()
        (folder / "product" / "file").write_text("all of it")
        assert not root.exists()
        publish(folder / "product", root)
    assert (root / "file").read_text() == "all of it"
    assert list(tmp_path.iterdir()) == [root]


def fail_halfway(root, error):
    with staging_folder(root) as folder:
        (folder / "half").write_text("half of it")
        raise error


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError("diverged")])
def test_a_failure_leaves_nothing(tmp_path, error):
    with pytest.raises(KeyboardInterrupt if error is KeyboardInterrupt else RuntimeError):
        fail_halfway(tmp_path / "out", error)
    assert not list(tmp_path.iterdir())


def test_a_second_process_is_refused_and_a_killed_one_is_forgotten(tmp_path):
    root = tmp_path / "out"
    with holder(root) as process:
        with pytest.raises(BlockingIOError, match=r"out is in use by another process: wait"), staging_folder(root):
            pass
        process.kill()
    with staging_folder(root) as folder:
        assert not list(folder.iterdir())
    assert not list(tmp_path.iterdir())


def be_overtaken(root):
    with staging_folder(root) as folder:
        (folder / "product").mkdir()
        (folder / "product" / "file").write_text("an hour of work")
        root.mkdir()
        (root / "stranger").write_text("came in between")
        publish(folder / "product", root)


def test_an_output_that_holds_anything_is_refused_and_a_product_is_never_lost(tmp_path):
    root = tmp_path / "out"
    with pytest.raises(FileExistsError, match=r"other files.*what was to become it is in") as refusal:
        be_overtaken(root)
    product = Path(str(refusal.value).rpartition(" is in ")[2])
    assert (product / "file").read_text() == "an hour of work"
    with pytest.raises(FileExistsError, match="choose another output folder"), staging_folder(root):
        pass
    with pytest.raises(FileExistsError, match="is a file"), staging_folder(root / "stranger"):
        pass


def test_a_full_disk_is_one_sentence_and_leaves_nothing(tmp_path):
    with pytest.raises(OSError, match=r"out could not be written \(No space left on device\): make room"):
        fail_halfway(tmp_path / "out", OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    assert not list(tmp_path.iterdir())


def test_a_claim_on_a_folder_that_was_discarded_meanwhile_is_none(tmp_path, monkeypatch):
    folder, opened = tmp_path / "folder", os.open

    def open_and_be_overtaken(path, flags, mode=0o777):
        descriptor = opened(path, flags, mode)
        monkeypatch.undo()
        discard(folder)
        return descriptor

    monkeypatch.setattr(os, "open", open_and_be_overtaken)
    with pytest.raises(BlockingIOError, match="another process"), claimed(folder):
        pass
    with claimed(folder):
        pass
