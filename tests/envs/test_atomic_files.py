"""Files that appear whole or not at all."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from dualhead_envs.atomic_files import not_written, write_atomically


def test_a_file_that_cannot_be_written_leaves_the_old_one_and_says_its_name(tmp_path):
    import resource

    target = tmp_path / "card.json"
    write_atomically(target, "old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000, hard))
    try:
        with pytest.raises(OSError, match=r"card\.json could not be written \(File too large\): make room"):
            write_atomically(target, "new" * 1_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [path.name for path in tmp_path.iterdir()] == ["card.json"]
    assert target.read_text() == "old"


def test_a_place_that_holds_no_files_is_named():
    with pytest.raises(OSError, match=r"/dev/null/card\.json could not be written .*: choose a place"):
        write_atomically(Path("/dev/null/card.json"), "anything")


def test_what_stands_is_said_between_the_reason_and_the_advice():
    sentence = not_written("RUN/000004", OSError(errno.ENOSPC, "any"), "; 000002 stands").strerror
    assert sentence.startswith("RUN/000004 could not be written (No space left on device); 000002 stands: make room")
