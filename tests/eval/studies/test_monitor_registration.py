"""The registered protocol agrees with the sweep that trains its arms, and names only what exists."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from dualhead_envs.bypass.perturbations.perturbation import parse_perturbation
from dualhead_envs.validated_json import validated
from dualhead_eval.monitor.aggregation import AGGREGATES
from dualhead_eval.monitor.signals.registry import SIGNALS
from dualhead_eval.monitor.thresholds.registry import make_threshold
from dualhead_eval.studies.monitor.registration import Registration, registered, registered_resampled

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("env", ["v2", "v3"])
def test_the_sweep_trains_the_registered_arms(env):
    protocol = registered()
    sweep = yaml.safe_load((ROOT / f"sweeps/monitor_{env}.yaml").read_text())
    budget = protocol.presets["full"]
    assert sweep["seeds"] == budget.seeds
    assert sweep["flags"] == {"steps": budget.steps}
    trained = {}
    for configuration in sweep["configurations"]:
        fields = yaml.safe_load((ROOT / configuration["config"]).read_text())["policy"]
        flags = {name.removeprefix("policy."): value for name, value in configuration.get("flags", {}).items()}
        trained[configuration["name"]] = {k: v for k, v in (fields | flags).items() if k != "type"}
    assert trained == protocol.arms


def test_the_executor_is_the_uniform_oracle_of_another_seed():
    protocol = registered()
    assert protocol.executor.policy == protocol.arms["Ku"]


def test_everything_named_exists():
    protocol = registered()
    for cell in protocol.log.cells:
        for environment in protocol.environments.values():
            parse_perturbation(cell, environment.env_id)
    assert set(protocol.scoring.signals) <= set(SIGNALS)
    for rule in (protocol.scoring.step, protocol.scoring.episode):
        assert rule.aggregator in AGGREGATES
        make_threshold(rule.threshold)
    for threshold in protocol.criteria.S3.thresholds:
        make_threshold(threshold)
    parts = 2 + len(protocol.log.cells)
    assert len(set(protocol.log.cells)) == parts - 2
    for budget in protocol.presets.values():
        assert max(budget.calibration_episodes, budget.nominal_episodes, budget.cell_episodes) < 1000


def test_an_arm_may_not_share_the_executors_seed():
    document = registered().model_dump()
    document["executor"]["seed"] = document["presets"]["full"]["seeds"][0]
    with pytest.raises(ValueError, match="expected another one: here"):
        validated(document, Registration, source="protocol", remedy="here")


def test_resampled_arms_sample_policies_of_a_trained_arm_that_share_nothing_yet():
    protocol, resampled = registered(), registered_resampled()
    for arm in resampled.arms:
        assert arm.name not in protocol.arms
        assert protocol.arms[arm.of] == {"source_noise_beta": 1.0}
        assert arm.coupling.source_noise_beta == 0
    assert set(resampled.claims) <= {arm.name for arm in resampled.arms}
