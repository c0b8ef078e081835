"""The gate files in results/ can be read, say what they are, hold the protocol, and give the numbers published."""

from __future__ import annotations

from pathlib import Path

import pytest

from dualhead_eval.evaluation.rollouts import ROLLOUTS_SUFFIXES, read_closed_loop
from dualhead_eval.gate import read_gate
from dualhead_eval.report.content import make_report, report_json
from dualhead_eval.studies.study_plan import GATE_SUFFIX

FOLDER = Path(__file__).parents[3] / "results"
#: Folders of robot policies, by environment; the second of each holds what was trained before a choice was mended.
ROBOT_FOLDERS = {"v2": ("v2", "v2_noisy_paper_network"), "v3": ("v3", "v3_exact_apex")}
ROBOT_GATES = sorted(
    (env, path)
    for env, folders in ROBOT_FOLDERS.items()
    for folder in folders
    for path in (FOLDER / folder).glob("*" + GATE_SUFFIX)
)
assert {path.parent.name for _, path in ROBOT_GATES} == {name for names in ROBOT_FOLDERS.values() for name in names}


@pytest.mark.parametrize(
    ("env", "path"),
    ROBOT_GATES,
    ids=lambda value: value if isinstance(value, str) else f"{value.parent.name}/{value.name}",
)
def test_a_gate_states_its_configuration_budget_and_protocol(env, path):
    gate = read_gate(path)
    name, _, budget = path.name.removesuffix(GATE_SUFFIX).rpartition("-")
    steps = 1000 * int(budget.removesuffix("k"))
    assert gate.label == f"{name}, {steps} steps"
    assert gate.provenance["training_step"] == steps
    # A checkpoint on the way is a run of fewer steps only where the learning rate does not look ahead.
    budget = gate.provenance["training"]["steps"]
    assert budget == steps or (budget > steps and gate.provenance["config"]["lr_schedule"] == "constant")
    assert gate.provenance["training"]["batch_size"] == 128
    assert gate.provenance["dataset"]["split"] == "test"
    assert (FOLDER.parent / "configs" / env / f"{name}.yaml").is_file()
    assert gate.n_conditions == {"v2": 75, "v3": 36}[env]
    assert (gate.counts.reshape(gate.n_conditions, -1).sum(axis=1) == 1280).all()
    assert (gate.reference_nfe, gate.reference_tau) == (20, {"v2": 0.11, "v3": 0.18}[env])


def test_committed_results_stay_small():
    assert sum(path.stat().st_size for path in FOLDER.rglob("*") if path.is_file()) < 15e6


@pytest.mark.parametrize(
    ("folder", "episodes"),
    # The benchmark of other policies says its 50 episodes, with Wilson's intervals, beside every rate.
    [("v2", 150), ("studies/closed_loops", 150), ("multimodality", 50)],
)
def test_closed_loop_outcomes_are_of_enough_episodes(folder, episodes):
    found = sorted(path for suffix in ROLLOUTS_SUFFIXES for path in (FOLDER / folder).rglob("*" + suffix))
    assert found
    assert all(read_closed_loop(path)[1].episodes >= episodes for path in found)


#: What ``dualhead report --json`` printed when these files were published.
PUBLISHED = {
    "v2/A_independent-50k": [
        ["joint", "position", 0.9987604166666667, 0.49847402330081614, -0.0013838700939015369, -0.002776213060688234]
    ],
    "v2_noisy_paper_network/G_consistency_3_paper_network-50k": [
        ["joint", "position", 0.6289270833333334, 0.4764641988622578, 0.1981014240795575, 0.41577399635187934]
    ],
    "v3_exact_apex/pose_consistency_3_rotation_1-20k": [
        ["joint", "position", 0.6262152777777777, 0.4903884881091366, 0.14533351770127084, 0.29636404855598214],
        ["joint", "rotation", 0.6953993055555555, 0.4912029693352795, -0.06486272391396838, -0.1320487211259001],
        ["position", "rotation", 0.7304036458333333, 0.4888157418522538, -0.22974525314193284, -0.47000379380452545],
    ],
}
#: Ends of rho's 95 % interval, smallest equivalence band and p-value, from the frozen bootstrap.
PUBLISHED_INTERVALS = {
    "v2/A_independent-50k": [-0.00914699647955681, 0.003683334507265539, 0.008183851273083307, 0.4027986006996502],
    "v2_noisy_paper_network/G_consistency_3_paper_network-50k": [
        0.4081802225841762,
        0.42355617936972173,
        0.42244647375883754,
        0.0009995002498750624,
    ],
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_numbers_are_recomputed(name):
    rows = report_json(make_report([read_gate(FOLDER / f"{name}{GATE_SUFFIX}")]))
    found = [[*row["heads"], *(row[key] for key in ("valid_rate", "capacity", "delta", "rho"))] for row in rows]
    for mine, published in zip(found, PUBLISHED[name], strict=True):
        assert mine[:2] == published[:2]
        assert mine[2:] == pytest.approx(published[2:], abs=1e-12)
    if name in PUBLISHED_INTERVALS:
        interval = rows[0]["intervals"]["rho"]
        numbers = [interval["low"], interval["high"], rows[0]["equivalence"]["width"], rows[0]["p_value"]]
        assert numbers == pytest.approx(PUBLISHED_INTERVALS[name], abs=1e-12)
