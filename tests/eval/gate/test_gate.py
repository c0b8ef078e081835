"""Gate files come back as they were written, or are refused in one sentence."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest

from dualhead_eval.effects.counts import joint_counts
from dualhead_eval.gate.file import FORMAT, gate_digest, read_gate, write_gate
from dualhead_eval.gate.gate import Gate
from dualhead_eval.residuals.strata import residual_strata


@pytest.fixture
def gate():
    rng = np.random.default_rng(0)
    a, b = rng.integers(-1, 3, size=(2, 5, 40))
    strata = residual_strata(rng.random((1, 2, 5, 40)), [[a, a]], [[b, np.where(b == 0, 0, -1)]])
    return Gate(
        heads=("joint", "position"),
        n_modes=3,
        taus=[0.5, 0.6],
        nfes=[20],
        reference_tau=0.5,
        reference_nfe=20,
        counts=np.stack([joint_counts(a, b, 3), joint_counts(a, np.where(b == 0, 0, -1), 3)])[None],
        conditions=rng.normal(size=(5, 3)),
        pair_ids=np.arange(5),
        target_probabilities=np.full(3, 1 / 3),
        provenance={
            "label": "a run",
            "seeds": {10: 1, 9: 2},
            "loss": np.float64(0.25),
            "partition": {"name": "ring"},
        },
        strata={"position": strata},
    )


def test_a_gate_survives_the_disk(gate, tmp_path):
    path = write_gate(gate, tmp_path / "deep" / "run.json")
    back = read_gate(path)
    np.testing.assert_array_equal(back.counts, gate.counts)
    np.testing.assert_array_equal(back.conditions, gate.conditions)
    np.testing.assert_array_equal(back.pair_ids, gate.pair_ids)
    np.testing.assert_array_equal(back.target_probabilities, gate.target_probabilities)
    for name in ("n", "total", "squares", "median", "u"):
        np.testing.assert_array_equal(getattr(back.strata["position"], name), getattr(gate.strata["position"], name))
    assert (back.heads, back.taus, back.nfes, back.label) == (gate.heads, gate.taus, gate.nfes, "a run")
    assert gate_digest(back) == gate_digest(gate) == json.loads(path.read_text())["sha256"]
    assert list(path.parent.iterdir()) == [path]


def test_an_existing_file_is_kept_unless_asked(gate, tmp_path):
    path = write_gate(gate, tmp_path / "run.json")
    before = path.read_bytes()
    with pytest.raises(FileExistsError, match="choose another name"):
        write_gate(replace(gate, provenance={}), path)
    assert path.read_bytes() == before
    write_gate(replace(gate, provenance={}), path, overwrite=True)
    assert read_gate(path).label == "unnamed run"


def test_every_truncation_is_refused(gate, tmp_path):
    whole = write_gate(gate, tmp_path / "run.json").read_bytes()
    for length in [*range(0, 200, 7), len(whole) // 2, len(whole) - 3]:
        cut = tmp_path / "cut.json"
        cut.write_bytes(whole[:length])
        with pytest.raises(ValueError, match="truncated") as error:
            read_gate(cut)
        assert "\n" not in str(error.value)


def test_an_edited_file_is_refused(gate, tmp_path):
    path = write_gate(gate, tmp_path / "run.json")
    document = json.loads(path.read_text())
    document["content"]["counts"]["values"][0] += 1
    path.write_text(json.dumps(document))
    with pytest.raises(ValueError, match="changed after it was written"):
        read_gate(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1, 2]", "not a gate file"),
        ('{"a": 1}', "not a gate file"),
        ('{"format": "dualhead-gate/2"}', "dualhead-gate/2"),
        (f'{{"format": "{FORMAT}"}}', "lacks its content"),
        ("\x00\x01binary", "not JSON"),
    ],
)
def test_foreign_files_are_refused(text, message, tmp_path):
    path = tmp_path / "foreign.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_gate(path)


def test_binary_files_and_missing_files_are_refused(tmp_path):
    path = tmp_path / "model.safetensors"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match="not JSON"):
        read_gate(path)
    with pytest.raises(FileNotFoundError, match="dualhead evaluate"):
        read_gate(tmp_path / "absent.json")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"n_modes": 1}, "n_modes=1"),
        ({"n_modes": 4}, "shape"),
        ({"heads": ("joint",)}, "two or more"),
        ({"heads": ("joint", "joint")}, "different names"),
        ({"taus": [0.6, 0.5]}, "increasing"),
        ({"reference_tau": 0.7}, "reference"),
        ({"conditions": np.zeros((4, 3))}, "conditions"),
        ({"conditions": np.full((5, 3), np.nan)}, "NaN"),
        ({"pair_ids": np.arange(4)}, "pair_ids"),
        ({"target_probabilities": np.array([0.5, 0.6, 0.1])}, "sum to 1"),
        ({"counts": np.zeros((1, 2, 5, 4, 4))}, "dtype"),
        ({"strata": {}, "counts": np.full((1, 2, 5, 4, 4), -1)}, "negative"),
    ],
)
def test_inconsistent_gates_cannot_be_built(gate, change, message):
    with pytest.raises(ValueError, match=message) as error:
        replace(gate, **change)
    assert "\n" not in str(error.value)


def test_thresholds_that_saw_different_samples_are_refused(gate):
    counts = gate.counts.copy()
    counts[0, 1, 0, 0, 0] += 1
    with pytest.raises(ValueError, match="different numbers of samples"):
        replace(gate, counts=counts)


def test_provenance_must_be_json(gate, tmp_path):
    for value in (float("nan"), object()):
        with pytest.raises(ValueError, match="plain JSON"):
            write_gate(replace(gate, provenance={"loss": value}), tmp_path / "run.json")
        assert not list(tmp_path.iterdir())


def test_operating_points_that_were_not_scanned_are_named(gate):
    assert gate.table(0.6).shape == (5, 4, 4)
    with pytest.raises(KeyError, match=r"tau=0\.7 was not evaluated"):
        gate.table(0.7)
    with pytest.raises(KeyError, match="nfe=5 was not evaluated"):
        gate.table(nfe=5)


def test_no_damaged_file_escapes_as_anything_but_a_sentence(gate, tmp_path):
    """Any one byte changed: refused in one sentence, or the very same gate (a blank between tokens)."""
    whole = write_gate(gate, tmp_path / "run.json").read_bytes()
    rng = np.random.default_rng(0)
    path = tmp_path / "damaged.json"
    for where in rng.integers(0, len(whole), size=150):
        damaged = bytearray(whole)
        damaged[where] = rng.integers(0, 256)
        path.write_bytes(damaged)
        sentence = ""
        try:
            survivor = gate_digest(read_gate(path))
        except ValueError as error:
            survivor, sentence = gate_digest(gate), str(error)
        assert survivor == gate_digest(gate)
        assert "\n" not in sentence


@pytest.mark.parametrize(
    "change",
    [
        {"counts": {"shape": [1], "values": [2**70]}},
        {"counts": {"shape": [1], "values": [1.5]}},
        {"counts": {"shape": [3], "values": [1]}},
        {"counts": None},
        {"heads": None},
        {"strata": {"position": {}}},
        {"target_probabilities": [0.1]},
    ],
)
def test_content_that_never_was_a_gate_is_refused_even_with_a_right_checksum(gate, change, tmp_path):
    path = write_gate(gate, tmp_path / "run.json")
    content = json.loads(path.read_text())["content"] | change
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    digest = hashlib.sha256(canonical.encode()).hexdigest()
    path.write_text(json.dumps({"format": FORMAT, "sha256": digest, "content": content}))
    with pytest.raises(ValueError, match="inconsistent gate"):
        read_gate(path)


def test_numbers_that_json_lacks_are_refused(gate, tmp_path):
    path = write_gate(gate, tmp_path / "run.json")
    path.write_text(path.read_text().replace('"reference_tau":0.5', '"reference_tau":NaN'))
    with pytest.raises(ValueError, match="NaN, which is not a number of JSON"):
        read_gate(path)
    path.write_text("[" * 100_000)
    with pytest.raises(ValueError, match="nested too deeply"):
        read_gate(path)


def resealed(gate, path, change):
    """A gate file whose content ``change`` has edited, with a checksum that is right again."""
    write_gate(gate, path)
    content = json.loads(path.read_text())["content"]
    change(content)
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    digest = hashlib.sha256(canonical.encode()).hexdigest()
    path.write_text(json.dumps({"format": FORMAT, "sha256": digest, "content": content}))
    return path


def move_a_pair(content):
    values = content["counts"]["values"]
    per_tau = len(values) // 2
    for start in (0, per_tau):  # the same pair at both thresholds, from one valid cell to another
        values[start] += 1
        values[start + 4] -= 1


def set_stratum(field, value):
    def change(content):
        content["strata"]["position"][field]["values"][0] = value

    return change


EDITS = {
    "a pair moved to another cell": (move_a_pair, "other same-mode and cross-mode pairs"),
    "more valid pairs at a higher threshold": (
        lambda content: content["counts"]["values"].reverse(),
        "higher threshold|other same-mode",
    ),
    "a partition of other modes": (
        lambda content: content["provenance"].update(partition={"n_modes": 2}),
        "partition has n_modes=2",
    ),
    "a partition of another threshold": (
        lambda content: content["provenance"].update(partition={"tau": 0.9}),
        r"partition has tau=0\.9",
    ),
    "another number of pairs": (
        lambda content: content["provenance"].update(pairs_per_condition=41),
        "pairs_per_condition=41, its tables hold 40",
    ),
    "a condition given twice": (
        lambda content: (
            content["conditions"]["values"].__setitem__(slice(3, 6), content["conditions"]["values"][:3]),
            content["pair_ids"]["values"].__setitem__(1, 0),
        ),
        "same pair and state twice",
    ),
    "a negative sum of distances": (set_stratum("total", -1.0), "that no distances have"),
    "squares below the sum's": (set_stratum("squares", 0.0), "that no distances have"),
    "a median beyond the mean's reach": (set_stratum("median", 1e6), "that no distances have"),
    "a median of nothing": (set_stratum("median", None), "that no distances have"),
    "a label that clears the screen": (
        lambda content: content["provenance"].update(label="\x1b[2J"),
        "printable text",
    ),
    "a head that breaks the line": (lambda content: content["heads"].__setitem__(0, "a\nb"), "printable text"),
    "an unknown field": (lambda content: content.update(note="mine"), "unknown field 'note'"),
    "a missing field": (lambda content: content.pop("strata"), "lacks the field 'strata'"),
    "a count that is a string": (lambda content: content["counts"]["values"].__setitem__(0, "7"), "counts.values.0"),
    "an array of another shape": (lambda content: content["counts"].update(shape=[1, 2, 5, 4, 5]), "holds 160 values"),
    "a negative threshold": (lambda content: content.update(taus=[-0.5, 0.5]), "increasing numbers from 0"),
    "no step at all": (lambda content: content.update(nfes=[0], reference_nfe=0), "increasing numbers from 1"),
    "another unit": (lambda content: content["strata"]["position"].update(unit="furlong"), "'mm', 'deg' or '1'"),
    "a negative pair": (lambda content: content["pair_ids"]["values"].__setitem__(0, -1), "pair_ids"),
}


@pytest.mark.parametrize("what", EDITS)
def test_a_gate_that_no_evaluation_gives_is_refused_even_with_a_right_checksum(what, gate, tmp_path):
    change, sentence = EDITS[what]
    with pytest.raises(ValueError, match=sentence) as refusal:
        read_gate(resealed(gate, tmp_path / "run.json", change))
    assert str(refusal.value).isprintable()


def test_a_change_that_is_possible_is_believed(gate, tmp_path):
    path = resealed(gate, tmp_path / "run.json", lambda content: content["provenance"].update(label="another name"))
    assert read_gate(path).label == "another name"
