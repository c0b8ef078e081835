"""Films and sheets show what was recorded and predicted: the modes of both heads, in their colours."""

from __future__ import annotations

import json
import shutil

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

from dualhead_envs.dataset_columns import data_files
from dualhead_envs.ribbon import NO_MODE_COLOR, mode_color, pair_ribbons
from dualhead_eval.cli import main
from dualhead_eval.evaluation.decision_pictures import LINE, decided
from dualhead_eval.evaluation.films import film_rollouts


@pytest.fixture(scope="module")
def filmed(trained, ring_data, tmp_path_factory):
    """Three recorded episodes of a ring and their films."""
    root = tmp_path_factory.mktemp("films")
    arguments = ["evaluate", "--policy", trained, "--dataset", ring_data / "test", "--control", "position"]
    arguments += ["--record", root / "rollouts", "--video", root / "films", "--episodes", "3", "--samples", "4"]
    arguments += ["--output", root / "loop.gate.json"]
    assert main([str(argument) for argument in arguments]) == 0
    return root


def frames_of(path):
    with av.open(path) as film:
        return [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]


def test_every_episode_has_a_film_of_its_steps(filmed):
    films = sorted((filmed / "films").iterdir())
    assert [path.name for path in films] == ["episode_000.mp4", "episode_001.mp4", "episode_002.mp4"]
    outcomes = json.loads((filmed / "rollouts" / "meta" / "dualhead.json").read_text())["outcomes"]
    for path, outcome in zip(films, outcomes, strict=True):
        frames = frames_of(path)
        assert len(frames) == outcome["frames"] + outcome["frames"] // 8
        assert frames[0].shape == (480 + LINE, 480, 3)
        # A film moves: the path grows.
        assert np.abs(frames[0].astype(int) - frames[outcome["frames"] - 1]).max() > 100


def test_a_recording_that_does_not_repeat_itself_is_not_filmed(filmed, tmp_path):
    shutil.copytree(filmed / "rollouts", tmp_path / "rollouts")
    (file,) = data_files(tmp_path / "rollouts")
    table = pq.read_table(file)
    moved = pa.array([[x + 0.5 for x in row] for row in table["action"].to_pylist()], table["action"].type)
    pq.write_table(
        table.set_column(table.column_names.index("action"), "action", moved), file, write_page_checksum=True
    )
    with pytest.raises(
        ValueError, match="does not repeat itself: the episode of seed 0 leaves its recording at step 1"
    ):
        film_rollouts(tmp_path / "rollouts", tmp_path / "films")
    assert not (tmp_path / "films").exists()


def test_films_are_not_replaced_unasked(filmed, capsys):
    arguments = ["evaluate", "--rollouts", filmed / "rollouts", "--output", filmed / "again.gate.json"]
    assert main([str(a) for a in [*arguments, "--video", filmed / "films"]]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert not (filmed / "again.gate.json").exists()


def test_a_sheet_shows_both_heads_under_every_condition(trained, ring_data, tmp_path, capsys):
    arguments = ["evaluate", "--policy", trained, "--dataset", ring_data / "test", "--pairs", "8", "--conditions", "4"]
    arguments += ["--preview", tmp_path / "sheet.png", "--output", tmp_path / "open.gate.json"]
    assert main([str(argument) for argument in arguments]) == 0
    assert "preview:" in capsys.readouterr().out
    sheet = np.asarray(Image.open(tmp_path / "sheet.png"))
    assert sheet.shape == (2 * (480 + LINE), 3 * 480, 3)
    assert (sheet[480 + LINE :, 480:] == 255).all()  # four of six places are taken
    assert (sheet[: 480 + LINE] != 255).any(axis=-1).mean() > 0.5


class _Halves:
    """Modes of a path by the sign of x; valid from 0.5 m."""

    n_modes, tau = 2, 0.5

    def score(self, path, condition):
        x = np.asarray(path)[..., -1, 0]
        return (x < 0).astype(int), np.abs(x)

    def to_dict(self):
        return {"name": "halves"}


@pytest.mark.parametrize(
    ("first", "second", "words", "heads"),
    [
        ([1.0, 1.0, -1.0], [1.0, -1.0, -1.0], "heads agree; 2 of 3 drawn pairs agree", [0, 0]),
        ([1.0, 1.0, -1.0], [-1.0, 1.0, 0.1], "heads disagree; 1 of 2 drawn pairs agree", [0, 1]),
        ([0.1, 1.0, 1.0], [1.0, 1.0, 1.0], "one head reaches a mode; 2 of 2 drawn pairs agree", [-1, 0]),
        ([0.1, 0.1, 0.1], [0.1, 0.2, 0.3], "no mode within reach", [-1, -1]),
    ],
)
def test_the_line_says_whether_the_pairs_agree(first, second, words, heads):
    def paths(ends):
        return np.array([np.linspace([0, 0], [end, 0.3], 5) for end in ends])

    shown = decided(paths(first), paths(second), np.zeros(3), _Halves())
    assert shown.words == words
    assert [mode for _, mode in shown.heads] == heads
    executed = shown.ribbons[-2:]
    assert [ribbon.color for ribbon in executed] == [mode_color(mode) for mode in heads]
    assert [ribbon.beads for ribbon in executed] == [False, True]


def test_held_pairs_are_drawn_and_not_counted():
    path = np.linspace([0, 0], [1, 0], 5)[None].repeat(3, axis=0)
    assert decided(path, path, np.zeros(3), _Halves(), held=1).words == "heads agree; 2 of 2 drawn pairs agree"


def test_what_reaches_no_mode_is_grey_and_faint():
    path = np.zeros((2, 5, 2))
    faint, *_, executed = pair_ribbons(path, path, [-1, -1], [-1, -1])
    assert executed.color == faint.color == NO_MODE_COLOR
    assert faint.opacity < executed.opacity
