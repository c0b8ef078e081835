"""A monitor beside a robot says what it says of the recording, bit for bit, and refuses what it cannot judge."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from dualhead_eval.evaluation.closed_loop import record_rollouts
from dualhead_eval.evaluation.decisions import Decisions
from dualhead_eval.monitor import Decision, Episode, Monitor
from dualhead_eval.monitor.monitor_file import load_monitor, require_layout, save_monitor
from dualhead_eval.monitor.recorded_episodes import open_rollouts
from dualhead_eval.monitor.resampling import resampled_episodes
from dualhead_eval.monitor.signals import SIGNALS, make_signal
from dualhead_eval.monitor.wrapper import MonitorWrapper
from dualhead_policy.pretrained import load_policy

#: Every signal that needs no ensemble.
NAMES = [name for name, kind in SIGNALS.items() if "members" not in kind.needs]


def every_signal():
    return [make_signal(name, epochs=1) if name in ("rnd", "logpzo") else make_signal(name) for name in NAMES]


@pytest.fixture(scope="module")
def fitted(rollouts):
    """A monitor of every signal, fitted on the calibration rollouts."""
    calibration = list(open_rollouts(rollouts["calibration"]))
    return Monitor(every_signal(), "ewma-max").fit(calibration, rng=np.random.default_rng(0))


ENV_KWARGS = {"representation": "nullspace", "control": "position"}


def test_a_monitor_reads_live_what_it_reads_of_the_recording_bit_for_bit(fitted, trained, tmp_path):
    policy, preprocess = load_policy(trained)
    policy.config.n_action_steps = 4
    root = tmp_path / "rollouts"
    record_rollouts(
        policy, preprocess, root, env_id="RotatingRing-v2", env_kwargs=ENV_KWARGS, episodes=2, samples=4, seed=5
    )
    recorded = open_rollouts(root)
    env = gym.make("dualhead_envs:RotatingRing-v2", **ENV_KWARGS)
    decisions = Decisions(policy, preprocess, 4)
    shapes = {"joint": (4, 16, 6), "position": (4, 16, 2)}

    def decide(observation, step):
        decisions(observation)
        joint, position = (decisions.predictions[f"prediction.{head}"].reshape(shapes[head]) for head in shapes)
        return recorded.builder.build(step, observation["agent_pos"], observation["environment_state"], joint, position)

    watched = MonitorWrapper(env, decide, fitted, decision_interval=4)
    for number in range(2):
        offline = fitted.read(recorded.episode(number))
        decisions.start(5 + number)
        _, info = watched.reset(seed=5 + number)
        live = [info["monitor"]]
        done = False
        while not done:
            *_, terminated, truncated, info = watched.step(decisions.chunk.pop(0)[6:])
            done = terminated or truncated
            if info["monitor"]["decision"]:
                live.append(info["monitor"])
        assert len(live) == len(offline) > 1
        for here, there in zip(live, offline, strict=True):
            assert here["step"] == there.step
            for name in NAMES:
                said = there.by_signal[name]
                assert here["by_signal"][name]["score"] == said.score
                assert here["by_signal"][name]["aggregate"] == said.aggregate
                assert here["by_signal"][name]["alarm"] == said.alarm


def test_another_policy_is_scored_on_the_recorded_observations(rollouts, trained):
    policy, preprocess = load_policy(trained)
    recorded = open_rollouts(rollouts["test"])
    once, again = (
        next(iter(resampled_episodes(recorded, policy, preprocess, samples=3, seed=seed))) for seed in (0, 0)
    )
    other = next(iter(resampled_episodes(recorded, policy, preprocess, samples=3, seed=1)))
    original = recorded.episode(0)
    assert [d.step for d in once.decisions] == [d.step for d in original.decisions]
    assert (once.decisions[0].observation == original.decisions[0].observation).all()
    assert once.decisions[0].position.shape == (3, 16, 2)
    assert (once.decisions[0].position == again.decisions[0].position).all()
    assert not (once.decisions[0].position == other.decisions[0].position).all()


def test_an_alarm_holds_until_the_next_episode(make_episode):
    rng = np.random.default_rng(1)
    monitor = Monitor(["residual"], "step").fit([make_episode(rng) for _ in range(19)], rng=rng)
    calm, wild, later = make_episode(rng).decisions[0], *make_episode(rng, shift=50.0).decisions[1:3]
    later = replace(calm, step=later.step)
    monitor.reset()
    alarms = [monitor.update(decision).alarm for decision in (calm, wild, later)]
    assert alarms == [False, True, True]
    with pytest.raises(ValueError, match="call reset"):
        monitor.update(calm)
    monitor.reset()
    assert not monitor.update(calm).alarm


def test_the_first_signal_is_the_one_that_the_alarm_is_about(make_episode):
    rng = np.random.default_rng(2)
    monitor = Monitor(["elapsed", "residual"], "step").fit([make_episode(rng) for _ in range(19)], rng=rng)
    reading = monitor.update(make_episode(rng, shift=50.0).decisions[0])
    assert not reading.alarm
    assert reading.by_signal["residual"].alarm
    assert reading.score == reading.by_signal["elapsed"].score


def test_a_diverged_decision_raises_the_alarm(make_episode):
    rng = np.random.default_rng(3)
    monitor = Monitor(["residual"]).fit([make_episode(rng) for _ in range(19)], rng=rng)
    broken = np.full((2, 16, 3), np.nan)
    reading = monitor.update(Decision(0, np.zeros(5), None, broken, broken))
    assert reading.score == np.inf
    assert reading.alarm


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e26])
def test_a_broken_chunk_is_read_by_every_signal_without_a_warning(fitted, rollouts, bad):
    recorded = open_rollouts(rollouts["test"])
    decision = recorded.episode(20).decisions[0]
    joint, position = decision.joint.copy(), decision.position.copy()
    joint[1, 3, 0] = position[0, 5, 1] = bad
    broken = recorded.builder.build(8, [0.0, 0.0], [1.0, 0.0, 1.0], joint, position)
    fitted.reset()
    fitted.update(decision)
    said = fitted.update(broken)
    assert said.score > 1e9
    assert said.alarm
    assert not any(np.isnan(reading.score) for reading in said.by_signal.values())
    if not np.isfinite(bad):
        assert said.by_signal["diverged"].score == 0.5
        assert broken.labels[1, 0] == broken.sides[1, 0] == -1
        assert broken.crossed is False


def test_signals_learn_from_other_episodes_than_thresholds(make_episode):
    """Thresholds of a learned signal rest on two thirds of the episodes, as those of others on all."""
    rng = np.random.default_rng(4)
    episodes = [make_episode(rng, key=f"made/{i}") for i in range(27)]
    with pytest.raises(ValueError, match=r"18 successful episodes .* beside the 9 that signals learn from"):
        Monitor(["max_abs_z"]).fit(episodes, rng=rng)
    Monitor(["residual"]).fit(episodes, rng=rng)
    training = [decision for episode in episodes for decision in episode.decisions]
    Monitor(["max_abs_z"]).fit(episodes[:19], rng=rng, training=training)


def test_a_saved_monitor_says_the_same(fitted, rollouts, tmp_path):
    recorded = open_rollouts(rollouts["test"])
    save_monitor(fitted, tmp_path / "M", layout=recorded.layout, samples=4)
    assert sorted(path.name for path in (tmp_path / "M").iterdir()) == ["monitor.json", "monitor.safetensors"]
    loaded, document = load_monitor(tmp_path / "M")
    episode = recorded.episode(0)
    assert loaded.read(episode) == fitted.read(episode)
    assert loaded.calibration == fitted.calibration
    assert next(entry.guarantee for entry in document.signals).startswith("a further success")
    require_layout(document, recorded.layout, "these rollouts")
    with pytest.raises(ValueError, match="horizon 8"):
        require_layout(document, recorded.layout | {"horizon": 8}, "these rollouts")
    with pytest.raises(FileExistsError):
        save_monitor(fitted, tmp_path / "M", layout=recorded.layout, samples=4)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda m: (m / "monitor.json").write_text("{"), "no dualhead-monitor/1"),
        (lambda m: (m / "monitor.json").write_text('{"format": "dualhead-gate/1"}'), "format"),
        (lambda m: (m / "monitor.safetensors").write_bytes(b"12345678"), "not readable"),
        (
            lambda m: (m / "monitor.json").write_text((m / "monitor.json").read_text().replace("ace_joint", "ace")),
            "not known",
        ),
        (
            lambda m: (m / "monitor.json").write_text(
                (m / "monitor.json").read_text().replace("band:const", "mondrian")
            ),
            "does not hold what",
        ),
    ],
)
def test_damaged_monitors_are_refused_in_one_sentence(make_episode, tmp_path, damage, message):
    rng = np.random.default_rng(5)
    monitor = Monitor(["ace_joint"], threshold="band:const").fit([make_episode(rng) for _ in range(33)], rng=rng)
    layout = {"layout": "panda", "horizon": 16, "observation": 5}
    save_monitor(monitor, tmp_path / "M", layout=layout, samples=6)
    assert load_monitor(tmp_path / "M")[0].threshold_name == "band:const"
    damage(tmp_path / "M")
    with pytest.raises(ValueError, match=message) as error:
        load_monitor(tmp_path / "M")
    assert "\n" not in str(error.value)
    (tmp_path / "M" / "monitor.safetensors").unlink()
    with pytest.raises(FileNotFoundError, match="does not exist"):
        load_monitor(tmp_path / "M")


def test_calibration_that_promises_nothing_is_refused(make_episode, tmp_path):
    rng = np.random.default_rng(6)
    episodes = [make_episode(rng, key=f"made/{i}") for i in range(18)]
    with pytest.raises(ValueError, match="at least 19"):
        Monitor(["residual"]).fit(episodes, rng=rng)
    with pytest.raises(ValueError, match="at least 21"):
        Monitor(["residual"], threshold="band:tfunc").fit([*episodes, *episodes[:2]], rng=rng)
    failed = [make_episode(rng, success=False, key="made/failed")] * 2
    with pytest.raises(ValueError, match=r"2 of 20 calibration episodes failed .*made/failed"):
        Monitor(["residual"]).fit(episodes + failed, rng=rng)
    assert Monitor(["residual"]).fit(episodes + failed, rng=rng, allow_failures=True).alpha == 0.05
    unfitted = Monitor(["residual"])
    for action in (
        lambda: unfitted.update(episodes[0].decisions[0]),
        lambda: save_monitor(unfitted, tmp_path / "M", layout={}, samples=1),
        lambda: MonitorWrapper(gym.make("CartPole-v1"), None, unfitted),
    ):
        with pytest.raises(ValueError, match="no threshold yet"):
            action()
    with pytest.raises(ValueError, match="each once"):
        Monitor(["residual", "residual"])
    with pytest.raises(ValueError, match="each once"):
        Monitor([])


def test_crossed_pairs_lie_on_two_sides_whatever_the_threshold(rollouts):
    recorded = open_rollouts(rollouts["calibration"])
    decision = recorded.episode(0).decisions[0]
    assert decision.crossed is False
    swapped = recorded.builder.build(0, [0.0, 0.0], [1.0, 0.0, 1.0], decision.joint, -decision.position)
    assert swapped.crossed is True
    assert make_signal("mismatch").score(swapped) == 1.0
    assert swapped.site.tolist() == [0.0, 0.0]
    with pytest.raises(ValueError, match=r"\(n, H, d_A\)"):
        recorded.builder.build(0, [0.0, 0.0], [1.0, 0.0, 1.0], decision.joint[0], decision.position)


def test_an_episode_knows_what_became_of_it(rollouts):
    recorded = open_rollouts(rollouts["test"])
    episode = recorded.episode(0)
    assert isinstance(episode, Episode)
    assert (episode.success, episode.failure, episode.stratum, episode.steps) == (False, "collision", "nominal", 24)
    assert [decision.step for decision in episode.decisions] == [0, 8, 16]
