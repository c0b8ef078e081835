"""The training behind a gate: which seed and checkpoint, which network and budget, whether its loss had settled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dualhead_eval.gate import Gate

#: Fields of a policy's configuration that say which network was trained, and how.
NETWORK_FIELDS = (
    "preconditioning",
    "conditioning",
    "velocity_layers",
    "velocity_width",
    "encoder_dim",
    "time_frequencies",
    "observation_noise",
    "padded_steps",
    "optimizer_lr",
    "lr_schedule",
    "normalize_actions",
)


@dataclass(frozen=True)
class TrainingRecord:
    """A gate's account of the training behind it.

    Attributes:
        seed: Training seed, None where it is unknown.
        checkpoint: Fingerprint of the weights, None in gates written without one.
        steps: Training steps of the checkpoint.
        batch_size: Windows per step.
        fresh_paths: Whether every step drew new paths instead of recorded ones.
        network: Values of :data:`NETWORK_FIELDS` by name, those that are known.
        plateaued: Whether the loss had settled, None where it is unknown.
        judged_loss: ``"flow_loss"`` or ``"loss"`` (the total loss): what ``plateaued`` is about.
        reference: Whether the gate is an exact reference, which nobody trained.
    """

    seed: int | None
    checkpoint: str | None
    steps: int | None
    batch_size: int | None
    fresh_paths: bool | None
    network: Mapping[str, Any]
    plateaued: bool | None
    judged_loss: str
    reference: bool

    @property
    def setting(self) -> tuple[Any, ...]:
        """What runs must share to be compared: network, steps, batch size, paths."""
        network = tuple(str(self.network.get(name)) for name in NETWORK_FIELDS)
        return (*network, self.steps, self.batch_size, self.fresh_paths, self.reference)

    @property
    def loss(self) -> str:
        """Whether the loss had settled, in words."""
        if self.reference:
            return "exact"
        if self.plateaued is None:
            return "unknown"
        state = "settled" if self.plateaued else "falling"
        return state if self.judged_loss == "flow_loss" else f"{state} (total)"

    @property
    def network_name(self) -> str:
        """The network in a few words, for example ``"linear_gaussian, film, 4 x 256"``; empty where it is unknown."""
        if "preconditioning" not in self.network:
            return ""
        n = self.network
        shape = f"{n.get('velocity_layers')} x {n.get('velocity_width')}"
        data = f"noise {n.get('observation_noise')}, padding {n.get('padded_steps')}"
        return f"{n['preconditioning']}, {n.get('conditioning')}, {shape}, {data}"


def policy_provenance_of(gate: Gate) -> Mapping[str, Any]:
    """The part of a gate's provenance that describes the policy; that of recorded rollouts lies one level deeper."""
    rollouts = gate.provenance.get("rollouts")
    policy = rollouts.get("policy") if isinstance(rollouts, Mapping) else None
    return policy if isinstance(policy, Mapping) else gate.provenance


def training_record(gate: Gate) -> TrainingRecord:
    """The record of ``gate``; what it does not say is None."""
    provenance = policy_provenance_of(gate)
    config, training = (_mapping(provenance.get(name)) for name in ("config", "training"))
    seed = training.get("seed", config.get("seed"))
    steps = provenance.get("training_step", training.get("steps"))
    return TrainingRecord(
        seed=None if seed is None else int(seed),
        checkpoint=provenance.get("checkpoint"),
        steps=None if steps is None else int(steps),
        batch_size=training.get("batch_size"),
        fresh_paths=training.get("fresh_paths"),
        network={name: config[name] for name in NETWORK_FIELDS if name in config},
        plateaued=training.get("plateaued"),
        judged_loss=str(training.get("judged_loss", "loss")),
        reference="reference" in str(provenance.get("method", "")),
    )


def settled(records: Sequence[TrainingRecord]) -> str:
    """How many of several runs had a settled loss, in words."""
    trained = [record for record in records if not record.reference]
    if not trained:
        return "exact" if records else "unknown"
    if len(trained) == 1:
        return trained[0].loss
    known = [record for record in trained if record.plateaued is not None]
    if not known:
        return "unknown"
    count = sum(bool(record.plateaued) for record in known)
    suffix = "" if all(record.judged_loss == "flow_loss" for record in known) else " (total)"
    return f"{count} of {len(trained)} settled{suffix}"


def _mapping(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
