"""YAML files that people write are read in one way: bounded, safe, and refused in one sentence."""

from __future__ import annotations

import pytest

from dualhead_envs.validated_json import Schema
from dualhead_envs.validated_yaml import MAX_BYTES, read_validated_yaml


class Named(Schema):
    name: str


#: Nine lists of nine aliases of the list before: 387 million values in half a kilobyte.
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{former}'] * 9)}]\n" for former, name in zip("abcdefgh", "bcdefghi", strict=True)
)


def read(path):
    return read_validated_yaml(path, Named, what="a thing", remedy="write another")


def test_what_fits_is_read(tmp_path):
    (tmp_path / "thing.yaml").write_text("name: one\n")
    assert read(tmp_path / "thing.yaml") == Named(name="one")


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("name: [", "is not YAML"),
        ("[" * 20_000, "is not YAML"),
        ("name: !!python/object/apply:os.getcwd []", "is not YAML"),
        ("name: 1\n", "name"),
        ("# " + "x" * MAX_BYTES, f"expected a thing of at most {MAX_BYTES}"),
        (BOMB, "holds more than 10000 values"),
        ("name: &a [*a]\n", "nested deeper than 32"),
    ],
    ids=["torn", "deep", "code", "wrong type", "huge", "bomb of aliases", "within itself"],
)
def test_what_does_not_is_refused(tmp_path, content, sentence):
    (tmp_path / "thing.yaml").write_text(content)
    with pytest.raises(ValueError, match=sentence) as refused:
        read(tmp_path / "thing.yaml")
    assert str(refused.value).endswith("write another")
    assert "\n" not in str(refused.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.yaml does not exist, expected a thing's YAML file"):
        read(tmp_path / "nowhere.yaml")
