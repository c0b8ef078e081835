"""Products for which there is no room: one sentence, the old product or none under its name, and a second try works."""

from __future__ import annotations

import resource
from contextlib import contextmanager

import pytest

from dualhead_envs.ring.record import record_ring
from dualhead_eval.cli import main
from dualhead_policy.pretrained import load_policy, policy_folder


@contextmanager
def files_no_larger_than(size):
    """The kernel's own limit, which a write beyond meets as it meets a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("size", [2_000, 20_000], ids=["while recording", "while assembling"])
def test_a_recording_goes_on_once_there_is_room(tmp_path, size):
    def record(name):
        return record_ring("RotatingRing-v2", tmp_path / name, episodes=128, conditions=2, shard_size=16)

    sentence = r"cut could not be written \(File too large\); what was recorded is kept: make room"
    with files_no_larger_than(size), pytest.raises(OSError, match=sentence):
        record("cut")
    assert not (tmp_path / "cut").exists()
    whole, cut = record("whole"), record("cut")
    for path in whole.rglob("*"):
        assert path.is_dir() or path.read_bytes() == (cut / path.relative_to(whole)).read_bytes()


def test_gate_files_pictures_and_pages_keep_their_names_for_whole_ones(trained, ring_data, tmp_path, capsys):
    gate = tmp_path / "run.gate.json"
    evaluate = ["evaluate", "--policy", str(trained), "--dataset", str(ring_data / "test"), "--pairs", "16"]
    products = {
        "--output": gate,
        "--json": tmp_path / "numbers.json",
        "--figure": tmp_path / "region.png",
        "--html": tmp_path / "page.html",
    }
    for option, product in products.items():
        command = evaluate if product == gate else ["report", str(gate)]
        with files_no_larger_than(300):
            assert main([*command, option, str(product)]) == 2
        last = capsys.readouterr().err.splitlines()[-1]
        assert last.startswith(f"dualhead: error: {product} could not be written (File too large): make room")
        assert not any(tmp_path.glob(f"*{product.name}*"))
        if product == gate:
            assert main([*command, option, str(product)]) == 0
    again = [word for option, product in products.items() if product != gate for word in (option, str(product))]
    assert main(["report", str(gate), *again]) == 0
    assert all(product.stat().st_size > 300 for product in products.values())


def test_a_card_that_cannot_be_renewed_stays(trained):
    folder = policy_folder(trained)
    before = (folder / "README.md").read_bytes()
    with files_no_larger_than(300), pytest.raises(OSError, match=r"README\.md could not be written"):
        load_policy(trained)[0].write_card(folder, {"rho": 0.5})
    assert (folder / "README.md").read_bytes() == before
