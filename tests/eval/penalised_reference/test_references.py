"""The optimum under endpoint consistency behind the sampling interface: the ring's, and a robot's demonstrations'."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from dualhead_envs.ring.generator import RingGenerator
from dualhead_eval.cli import main
from dualhead_eval.evaluation.conditions import open_conditions
from dualhead_eval.exact_reference import ExactReference
from dualhead_eval.gate.file import read_gate
from dualhead_eval.penalised_reference.opening import open_reference
from dualhead_eval.penalised_reference.optimum import PenalisedOptimum
from dualhead_eval.penalised_reference.ring import PenalisedRingReference
from dualhead_eval.penalised_reference.ring_law import matched_law
from dualhead_eval.penalised_reference.robot import PenalisedRobotReference, chord_jacobian
from dualhead_policy.flow.keyed_random import keyed_generator
from dualhead_policy.kinematics.kinematic_map import KinematicMap
from dualhead_policy.sampling import SamplingCoupling

CONDITIONS = RingGenerator(2).draw_conditions(np.random.default_rng(1), 2)
BATCH = {"observation.environment_state": torch.from_numpy(CONDITIONS).float()}


@pytest.mark.parametrize("representation", ["nullspace", "orthogonal"])
@pytest.mark.parametrize("prior", [[0.5, 0.5], [0.8, 0.2]])
def test_without_consistency_it_samples_what_the_exact_reference_does(representation, prior):
    options = {"mode_probabilities": prior, "source_noise_beta": 0.3}
    samplers = (
        ExactReference(2, representation, **options),
        PenalisedRingReference(representation, 0.0, **options),
    )
    exact, ours = (sampler.sample(BATCH, 32, num_steps=5, generator=keyed_generator(0)) for sampler in samplers)
    assert torch.allclose(exact.joint, ours.joint, atol=1e-4)
    assert torch.allclose(exact.position, ours.position, atol=1e-4)


def test_consistency_lifts_the_nullspace_rings_coordination():
    """The sign agreement of the mode-deciding coordinate, at lambda = 0 asin(-0.35) of it by chance."""
    direction = np.stack([CONDITIONS[:, 0], CONDITIONS[:, 1]], axis=-1)[:, None]
    agreement = []
    for weight in (0.0, 3.0):
        reference = PenalisedRingReference("nullspace", weight, source_noise_beta=0.0)
        samples = reference.sample(BATCH, 2_000, num_steps=20, generator=keyed_generator(0))
        middle = [path[..., 7, :] for path in (reference.map.to_position(samples.joint), samples.position.numpy())]
        sides = [(point * direction).sum(axis=-1) > 0 for point in middle]
        agreement.append((sides[0] == sides[1]).mean())
    # Binomial standard error of 4,000 pairs: 0.008.
    assert agreement[1] > agreement[0] + 0.03
    assert agreement[1] < 0.5


def test_the_polar_law_has_the_generators_moments_and_turns_the_heads_chunks_into_each_other():
    representation = PenalisedRingReference("polar", 1.0).map
    pair = matched_law(representation, RingGenerator(2), CONDITIONS[0], 0.0)
    mean = RingGenerator(2).mean_paths(CONDITIONS[0])
    assert np.abs(pair.half_b - (mean[1] - mean[0]).ravel() / 2).max() < 0.005
    assert np.abs(pair.kinematics @ pair.half_a - pair.half_b).max() < 0.02


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"representation": "cubic", "consistency_weight": 1}, "representation='cubic' is not one of"),
        ({"representation": "polar", "consistency_weight": -1}, "must be at least 0"),
        ({"representation": "polar", "consistency_weight": 1, "mode_angles": [0.0, 2.0]}, "are not opposite"),
    ],
)
def test_what_has_no_penalised_reference_is_refused(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        PenalisedRingReference(**arguments)


@pytest.fixture(scope="module")
def bypass():
    """Two conditions of a Panda that passes on either side: joint chunks, and positions by its kinematics."""
    rng = np.random.default_rng(0)
    start = np.array([0.0, 0.5, 0.0, -2.0, 0.0, 2.6, 0.8]) + 0.05 * rng.standard_normal((2, 1, 1, 7))
    side = np.array([0.25, 0.0, 0.2, 0.0, -0.1, 0.0, 0.1]) * np.sin(np.linspace(0.2, 2.0, 16))[:, None]
    joint = start + np.array([-1.0, 1.0])[:, None, None] * side
    position = KinematicMap("panda").position(torch.from_numpy(joint)).numpy()
    observation = {"observation.state": rng.standard_normal((2, 4)).astype(np.float32)}
    scales = tuple((x.mean(axis=(0, 1, 2)), x.std(axis=(0, 1, 2)) + 0.02) for x in (joint, position))
    return observation, joint, position, scales


def robot(bypass, weight):
    observation, joint, position, scales = bypass
    return PenalisedRobotReference(observation, joint, position, *scales, KinematicMap("panda"), weight)


def test_the_chord_maps_the_difference_of_the_modes_exactly(bypass):
    _, joint, position, _ = bypass
    moved = np.einsum("bhij,bhj->bhi", chord_jacobian(KinematicMap("panda"), joint), joint[:, 1] - joint[:, 0])
    assert np.abs(moved - (position[:, 1] - position[:, 0])).max() < 1e-6


def test_a_robots_samples_end_on_demonstrated_chunks(bypass):
    reference = robot(bypass, 3.0)
    batch = {key: torch.from_numpy(value) for key, value in bypass[0].items()}
    coupling = SamplingCoupling(source_noise_beta=0.0)
    samples = reference.sample(batch, 64, num_steps=20, coupling=coupling, generator=keyed_generator(0))
    for chunks, modes in ((samples.joint, bypass[1]), (samples.position, bypass[2])):
        distance = np.abs(chunks.numpy()[:, :, None] - modes[:, None]).max(axis=(-2, -1))
        assert np.quantile(distance.min(axis=-1), 0.9) < 1e-3
        assert (np.bincount(distance.argmin(axis=-1).ravel(), minlength=2) > 20).all()


def test_the_chord_stands_for_the_kinematics_in_head_as_decision(panda_data):
    """Head A's best response under the Panda's own kinematics moves its endpoints, and hardly ever its mode.

    At every step a_A minimises r |a - m_A|^2 + w |FK(a) - P_A a_B|^2, by Gauss-Newton, where P_A a_B is the optimum's.
    """
    conditions = open_conditions(panda_data / "test", 1)
    reference = open_reference(panda_data / "test", conditions.observation, 3.0, 0.0, {})
    samples, steps = 200, 10
    pair, deviation = reference.pair(0), reference.joint_scale[1]
    centre_a, centre_b = reference.joint[0].mean(axis=0), reference.position[0].mean(axis=0)
    jacobian = torch.func.vmap(torch.func.jacfwd(reference.kinematics.position))

    def image(chunk):
        pose = torch.from_numpy(chunk * deviation + reference.joint_scale[0])
        place = (reference.kinematics.position(pose).numpy() - reference.position_scale[0]) / reference.position_scale[
            1
        ]
        slope = jacobian(pose.reshape(-1, 7)).numpy().reshape(*place.shape, 7)
        return place, slope * deviation / reference.position_scale[1][:, None]

    x = np.random.default_rng(0).standard_normal((samples, 16 * 7))
    chord, moved = x.copy(), 0.0
    for step in range(steps):
        time, part = step / steps, 1 / (steps - step)
        optimum = PenalisedOptimum(pair, time, 3.0)
        w, centred = optimum.weight, x - time * centre_a.ravel()
        expected = centre_b + optimum.expected_b(centred).reshape(samples, 16, 3)
        own = PenalisedOptimum(pair, time, 0.0).endpoint_a(centred).reshape(samples, 16, 7) + centre_a
        end = start = optimum.endpoint_a(centred).reshape(samples, 16, 7) + centre_a
        for _ in range(3):
            place, slope = image(end)
            system = pair.loss_ratio * np.eye(7) + w * np.einsum("nhki,nhkj->nhij", slope, slope)
            gradient = pair.loss_ratio * (end - own) + w * np.einsum("nhki,nhk->nhi", slope, place - expected)
            end = end - np.linalg.solve(system, gradient[..., None])[..., 0]
        moved = max(moved, float(np.abs(end - start).max()))
        x = x + part * (end.reshape(samples, -1) - x)
        chord_end = optimum.endpoint_a(chord - time * centre_a.ravel()) + centre_a.ravel()
        chord = chord + part * (chord_end - chord)
    sides = [np.sign((chunk - centre_a.ravel()) @ pair.half_a) for chunk in (x, chord)]
    assert moved > 0.05
    assert (sides[0] != sides[1]).mean() < 0.02


def test_a_condition_that_was_not_demonstrated_is_refused(bypass):
    with pytest.raises(ValueError, match="not among the conditions"):
        robot(bypass, 3.0).sample({"observation.state": torch.zeros(1, 4)}, 2)


def test_the_command_writes_a_gate_of_the_optimum_for_the_ring_and_for_a_robot(ring_data, panda_data, tmp_path):
    for data, method in ((ring_data, "penalised reference"), (panda_data, "penalised reference (two-point")):
        output = tmp_path / f"{method[:5]}-{data.name}.gate.json"
        arguments = ["evaluate", "--exact", "--consistency-weight", "1", "--source-noise-beta", "0"]
        where = ["--dataset", str(data / "test"), "--output", str(output), "--conditions", "1"]
        assert main([*arguments, *where, "--pairs", "32", "--nfe", "5"]) == 0
        gate = read_gate(output)
        assert gate.provenance["method"].startswith(method)
        assert gate.provenance["consistency_weight"] == 1
        assert gate.counts.sum() == 32


def test_consistency_and_tokens_have_no_reference_together(ring_data, tmp_path, capsys):
    arguments = ["evaluate", "--exact", "--consistency-weight", "1", "--token", "oracle"]
    assert main([*arguments, "--dataset", str(ring_data / "test"), "--output", str(tmp_path / "x.json")]) == 2
    assert "leave --token out" in capsys.readouterr().err
