"""Every signal against an independent computation of its definition."""

from collections import Counter
from itertools import pairwise, permutations

import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist
from scipy.stats import entropy, spearmanr
from sklearn.metrics.pairwise import rbf_kernel
from sklearn.preprocessing import StandardScaler

from dualhead_eval.ensembles.scores import action_l2
from dualhead_eval.monitor.decision import Decision
from dualhead_eval.monitor.kinematics import position_map
from dualhead_eval.monitor.signals import SIGNALS, make_signal
from dualhead_eval.monitor.signals.signal import NEEDS
from dualhead_policy.kinematics.kinematic_map import KinematicMap


def distances_mm(a, b):
    """D(a_i, b_j) by SciPy, step by step."""
    return 1000 * np.mean([cdist(a[:, h], b[:, h]) for h in range(a.shape[1])], axis=0)


@pytest.mark.parametrize("seed", range(5))
def test_residuals_are_their_definitions(seed, make_decision):
    decision = make_decision(np.random.default_rng(seed))
    a, b = decision.pair
    n = len(a)
    across = distances_mm(a, b)
    off = [(i, j) for i in range(n) for j in range(n) if i != j]
    energy = 2 * np.mean([across[p] for p in off])
    energy -= np.mean([distances_mm(a, a)[p] for p in off]) + np.mean([distances_mm(b, b)[p] for p in off])
    expected = {
        "residual": across[0, 0],
        "residual_mean": np.trace(across) / n,
        "residual_matched": 0.5 * (across.min(axis=1).mean() + across.min(axis=0).mean()),
        "residual_energy": energy,
    }
    for name, value in expected.items():
        assert make_signal(name).score(decision) == pytest.approx(value, abs=1e-6)


def test_matching_forgives_heads_that_choose_their_modes_independently():
    """Both heads use both modes, in another order: the plain residual is large, the matched one zero."""
    modes = np.array([-1.0, 1.0, -1.0, 1.0])[:, None, None] * np.ones((4, 16, 2))
    decision = Decision(0, np.zeros(1), None, modes[::-1].copy(), modes)
    assert make_signal("residual").score(decision) > 1000
    assert make_signal("residual_matched").score(decision) == 0


def test_the_energy_residual_of_heads_alike_in_distribution_is_zero_in_the_mean():
    rng = np.random.default_rng(0)
    scores = []
    for _ in range(400):
        a, b = rng.standard_normal((2, 6, 4, 2))
        scores.append(make_signal("residual_energy").score(Decision(0, np.zeros(1), None, b, a)))
    assert abs(np.mean(scores)) < 4 * np.std(scores) / 20
    assert min(scores) < 0


@pytest.mark.parametrize(("name", "head"), [("variance_joint", 0), ("variance_position", 1)])
def test_variance_is_the_trace_of_the_covariance(name, head, make_decision):
    decision = make_decision(np.random.default_rng(1))
    samples = decision.pair[head]
    expected = 1e6 * np.mean([np.trace(np.cov(samples[:, h].T)) for h in range(samples.shape[1])])
    assert make_signal(name).score(decision) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("over_steps", ["mean", "sum"])
@pytest.mark.parametrize(("name", "head"), [("ace_joint", 0), ("ace_position", 1)])
def test_entropy_counts_joint_cells(name, head, over_steps, make_episode):
    rng = np.random.default_rng(2)
    episode = make_episode(rng)
    signal = make_signal(name, over_steps=over_steps)
    signal.fit(episode.decisions, rng)
    everything = np.concatenate([d.pair[head].reshape(-1, 3) for d in episode.decisions])
    # A decision of few distinct cells, so that some are shared.
    samples = 0.03 * np.ptp(everything, axis=0) * rng.integers(0, 2, size=(6, 16, 3))
    decision = Decision(0, np.zeros(1), None, samples, samples)
    side = 0.03 * np.ptp(everything, axis=0)
    per_step = []
    for h in range(16):
        cells = Counter(map(tuple, np.floor((samples[:, h] - samples.min(axis=(0, 1))) / side).astype(int).tolist()))
        per_step.append(entropy(list(cells.values()), base=2))
    combined = np.mean(per_step) if over_steps == "mean" else np.sum(per_step)
    assert combined > 0
    assert signal.score(decision) == pytest.approx(combined, abs=1e-6)


def test_entropy_leaves_out_a_dimension_that_never_varies():
    flat = np.random.default_rng(0).standard_normal((6, 16, 3)) * [1, 1, 0]
    decision = Decision(0, np.zeros(1), None, flat, flat)
    signal = make_signal("ace_position")
    signal.fit([decision], np.random.default_rng(0))
    assert np.isfinite(signal.score(decision))


@pytest.mark.parametrize(("name", "head"), [("stac_joint", 0), ("stac_position", 1)])
def test_stac_is_the_maximum_mean_discrepancy_on_the_shared_steps(name, head, make_episode):
    rng = np.random.default_rng(3)
    episode = make_episode(rng)
    signal = make_signal(name)
    signal.fit(episode.decisions, rng)
    signal.reset()
    scores = [signal.score(decision) for decision in episode.decisions]
    assert scores[0] == 0
    shared = [
        (x.pair[head][:, 8:].reshape(6, -1), y.pair[head][:, :8].reshape(6, -1)) for x, y in pairwise(episode.decisions)
    ]
    bandwidth = np.median(np.concatenate([cdist(x, y).ravel() for x, y in shared]))
    for score, (x, y) in zip(scores[1:], shared, strict=True):
        kernels = [rbf_kernel(u, v, gamma=1 / (2 * bandwidth**2)).mean() for u, v in ((x, x), (y, y), (x, y))]
        assert score == pytest.approx(kernels[0] + kernels[1] - 2 * kernels[2], abs=1e-6)


def test_single_sample_consistency_and_tracking_compare_with_the_chunk_before(make_decision):
    rng = np.random.default_rng(4)
    first, second = make_decision(rng, 0, control="position"), make_decision(rng, 8, control="position")
    chunks, tracking = make_signal("stac_single"), make_signal("tracking")
    assert chunks.score(first) == tracking.score(first) == 0
    gap = np.linalg.norm(first.position[0, 8:] - second.position[0, :8], axis=-1).mean()
    assert chunks.score(second) == pytest.approx(1000 * gap)
    assert tracking.score(second) == pytest.approx(1000 * np.linalg.norm(second.site - first.position[0, 7]))
    chunks.reset()
    assert chunks.score(second) == 0


def test_decisions_a_whole_chunk_apart_share_nothing(make_decision):
    rng = np.random.default_rng(4)
    signal = make_signal("stac_single")
    signal.score(make_decision(rng, 0))
    assert signal.score(make_decision(rng, 16)) == 0


def test_the_largest_deviation_is_scikit_learns_on_dimensions_that_vary():
    rng = np.random.default_rng(5)
    rows = rng.standard_normal((200, 4)) * [1, 5, 0.1, 0] + [0, 3, 0, 7]
    signal = make_signal("max_abs_z")
    signal.fit([Decision(0, row) for row in rows], rng)
    assert signal.left_out.tolist() == [3]
    observation = np.array([0.1, 40.0, 0.0, -100.0])
    scaler = StandardScaler().fit(rows[:, :3])
    z = np.abs(scaler.transform(observation[None, :3])) * np.sqrt(199 / 200)
    assert signal.score(Decision(0, observation)) == pytest.approx(z.max(), abs=1e-6)


def torch_network(arrays, name):
    """The stored layers as a torch network, in double precision."""
    layers, index = [], 0
    while f"{name}.{index}.w" in arrays:
        weight, bias = (torch.from_numpy(arrays[f"{name}.{index}.{kind}"]) for kind in "wb")
        linear = torch.nn.Linear(*weight.T.shape, dtype=torch.float64)
        linear.weight.data, linear.bias.data = weight, bias
        layers += [linear, torch.nn.ReLU()]
        index += 1
    return torch.nn.Sequential(*layers[:-1])


@pytest.fixture(scope="module")
def gaussian():
    """Correlated observations, and signals that learned them."""
    rng = np.random.default_rng(6)
    mixing = rng.standard_normal((4, 4))
    rows = rng.standard_normal((600, 4)) @ mixing + 5
    fitted = {}
    for name in ("rnd", "logpzo"):
        fitted[name] = make_signal(name, epochs=40)
        fitted[name].fit([Decision(0, row) for row in rows], np.random.default_rng(0))
    return rows, fitted


@pytest.mark.parametrize(("name", "widths"), [("rnd", [256, 256, 256, 128]), ("logpzo", [256, 256, 256, 4])])
def test_learned_scores_are_those_of_torch(gaussian, name, widths):
    rows, fitted = gaussian
    arrays = fitted[name].learned()
    x = torch.from_numpy((rows[:20] - rows.mean(axis=0)) / rows.std(axis=0))
    if name == "rnd":
        target, predictor = (torch_network(arrays, part) for part in ("target", "predictor"))
        assert [layer.out_features for layer in target[::2]] == [256, 128]
        expected = torch.linalg.vector_norm(predictor(x) - target(x), dim=1)
        network = predictor
    else:
        network = torch_network(arrays, "velocity")
        expected = ((x + network(torch.cat([x, torch.zeros(20, 1, dtype=x.dtype)], dim=1))) ** 2).sum(dim=1)
    assert [layer.out_features for layer in network[::2]] == widths
    scores = [fitted[name].score(Decision(0, row)) for row in rows[:20]]
    assert scores == pytest.approx(expected.detach().numpy(), rel=1e-6)


@pytest.mark.parametrize("name", ["rnd", "logpzo"])
def test_learned_scores_rise_away_from_the_data(gaussian, name):
    rows, fitted = gaussian
    centre = rows.mean(axis=0)
    inside, outside = (
        [fitted[name].score(Decision(0, centre + scale * (row - centre))) for row in rows[:100]] for scale in (1, 4)
    )
    assert np.median(outside) > np.quantile(inside, 0.9)


def test_the_flow_density_ranks_like_the_gaussian_that_made_the_data(gaussian):
    rows, fitted = gaussian
    centre, inverse = rows.mean(axis=0), np.linalg.inv(np.cov(rows.T))
    fresh = centre + 2 * (rows[:200] - centre)
    mahalanobis = [(row - centre) @ inverse @ (row - centre) for row in fresh]
    assert spearmanr([fitted["logpzo"].score(Decision(0, row)) for row in fresh], mahalanobis).statistic > 0.8


def test_ensemble_scores_average_ordered_pairs():
    rng = np.random.default_rng(7)
    members, fields = rng.standard_normal((3, 5, 16, 3)), rng.random((3, 3, 5))
    decision = Decision(0, np.zeros(1), members=members, member_fields=fields)
    pairs = list(permutations(range(3), 2))
    expected = 1000 * np.mean([action_l2(members)[p] for p in pairs])
    assert make_signal("action_l2").score(decision) == pytest.approx(expected)
    assert make_signal("vfd").score(decision) == pytest.approx(np.mean([fields[p] for p in pairs]))


def test_label_shares_count_pairs():
    labels = np.array([[0, 1, -1, 0], [0, 0, 1, -1]])
    paths = np.zeros((4, 16, 2))
    paths[3, 0, 0] = np.nan
    decision = Decision(
        24, np.zeros(1), None, paths, paths, labels=labels, diverged=np.array([True, False, False, False])
    )
    shares = {name: make_signal(name).score(decision) for name in ("mismatch", "invalid", "diverged", "elapsed")}
    assert shares == {"mismatch": 0.5, "invalid": 0.5, "diverged": 0.5, "elapsed": 24}


@pytest.mark.parametrize(("name", "width"), [("panda", 7), ("ring/nullspace", 6), ("ring/polar", 2)])
def test_kinematics_in_numpy_are_those_of_torch(name, width):
    rng = np.random.default_rng(8)
    values = rng.uniform(-2, 2, size=(5, 16, width))
    expected = KinematicMap(name).position(torch.from_numpy(values)).numpy()
    np.testing.assert_allclose(position_map(name)(values), expected, atol=1e-12)


def test_every_signal_says_what_it_needs():
    for name, kind in SIGNALS.items():
        assert kind.name == name
        assert kind.needs <= set(NEEDS)
        assert kind.unit


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (lambda make: make_signal("residul"), "not known"),
        (lambda make: make_signal("rnd", width=3), "does not take"),
        (lambda make: make_signal("rnd", epochs=0), "epochs=0"),
        (lambda make: make_signal("ace_joint", over_steps="max"), "over_steps"),
        (lambda make: make_signal("residual").score(Decision(0, np.zeros(2))), "no predictions"),
        (lambda make: make_signal("mismatch").score(Decision(0, np.zeros(2))), "mode labels"),
        (lambda make: make_signal("action_l2").score(Decision(0, np.zeros(2))), "members"),
        (lambda make: make_signal("vfd").score(Decision(0, np.zeros(2))), "velocity fields"),
        (lambda make: make_signal("max_abs_z").score(Decision(0, np.zeros(2))), "fitted"),
        (lambda make: make_signal("max_abs_z").fit([], None), "no decision"),
        (lambda make: make_signal("stac_joint").fit([make(np.random.default_rng(0))], None), "consecutive"),
        (
            lambda make: make_signal("residual_energy").score(make(np.random.default_rng(0), n=1)),
            "two pairs",
        ),
    ],
)
def test_what_a_signal_lacks_is_one_sentence(action, message, make_decision):
    with pytest.raises(ValueError, match=message) as error:
        action(make_decision)
    assert "\n" not in str(error.value)
