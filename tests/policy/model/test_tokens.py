"""Tokens: frequencies, draws, corruption and k-means assignment."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from sklearn.cluster import KMeans

from dualhead_policy.flow.keyed_random import keyed_generator
from dualhead_policy.model.token_corruption import draw_corruption
from dualhead_policy.model.tokens import TokenTable

MANY = 50_000


def test_replacement_and_null_probabilities_do_what_their_names_say():
    table = TokenTable(4, 0)
    clean = torch.zeros(MANY, dtype=torch.int64)
    noisy = table.corrupt(
        clean, draw_corruption((MANY,), table.n_tokens, keyed_generator(0)), replacement_prob=0.2, null_prob=0.1
    )
    share = torch.bincount(noisy, minlength=5) / MANY
    # A replacement is uniform over all tokens, the original among them.
    assert share.numpy() == pytest.approx([0.7 + 0.05, 0.05, 0.05, 0.05, 0.1], abs=0.006)
    assert table.one_hot(torch.tensor([2, 4])).tolist() == [[0, 0, 1, 0], [0, 0, 0, 0]]


def test_without_corruption_tokens_pass_unchanged():
    token, table = torch.arange(4), TokenTable(4, 0)
    corruption = draw_corruption((4,), table.n_tokens, keyed_generator(0))
    assert torch.equal(table.corrupt(token, corruption, replacement_prob=0, null_prob=0), token)


def test_marginal_draws_follow_the_training_frequencies():
    table = TokenTable(2, 0).fit_marginal(torch.tensor([0] * 8 + [1] * 2))
    drawn = table.draw((MANY,), "marginal", keyed_generator(1))
    assert drawn.float().mean().item() == pytest.approx(0.2, abs=0.01)
    uniform = table.draw((MANY,), "uniform", keyed_generator(1))
    assert uniform.float().mean().item() == pytest.approx(0.5, abs=0.01)


def test_window_tokens_are_the_clusters_of_scikit_learn():
    rng = np.random.default_rng(0)
    windows = np.concatenate([rng.normal(m, 0.1, (200, 32)) for m in (-1, 0, 1)]).astype(np.float32)
    table = TokenTable(3, 32)
    fitted = table.fit_clusters(windows, seed=0, what="windows")
    ours = table.assign(torch.from_numpy(windows).reshape(-1, 16, 2)).numpy()
    theirs = KMeans(3, n_init=4, random_state=0).fit_predict(windows)
    assert len({(a, b) for a, b in zip(ours, theirs, strict=True)}) == 3
    assert np.array_equal(fitted.numpy(), ours)
    assert table.marginal.numpy() == pytest.approx([1 / 3] * 3)


def test_displacement_tokens_see_what_a_window_does_and_not_where():
    rng = np.random.default_rng(0)
    side = rng.integers(2, size=400)
    start = rng.uniform(-1, 1, (400, 1, 3))
    velocity = np.stack([np.ones(400), 0.1 * (2 * side - 1), np.zeros(400)], axis=-1)
    steps = np.linspace(0, 1, 16)[None, :, None] * velocity[:, None]
    windows = (start + steps).reshape(400, -1).astype(np.float32)
    table = TokenTable(2, 48, displacement_axes=3)
    token = table.fit_clusters(windows, seed=0, what="windows").numpy()
    assert len({(a, b) for a, b in zip(token, side, strict=True)}) == 2
    elsewhere = torch.from_numpy((windows.reshape(-1, 16, 3) + np.array([5.0, -3.0, 2.0])).astype(np.float32))
    assert np.array_equal(table.assign(elsewhere).numpy(), token)
    # Each axis counts in units of the positions' own spread, which an axis that hardly moves cannot blow up.
    spread = windows.reshape(-1, 3).std(axis=0, ddof=1)
    assert table.axis_scale.numpy() == pytest.approx(spread, rel=1e-4)


def test_too_few_distinct_windows_are_refused():
    with pytest.raises(ValueError, match=r"fewer distinct windows than policy\.n_tokens=4"):
        TokenTable(4, 32).fit_clusters(np.zeros((100, 32), dtype=np.float32), seed=0, what="windows")
