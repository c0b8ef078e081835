"""The mechanism that a gate file measured, read from its provenance, and the paper's row for it.

The paper names its rows by environment and family (tab:main, tab:v3, tab:maps, tab:toy-corner). A gate whose
setting the paper did not run, for example a skewed ring prior, has no row.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dualhead_eval.gate import Gate
from dualhead_eval.gate.gate import DRAWS, POLICY_PAIR
from dualhead_eval.statistics.training_record import policy_provenance_of

#: Partition name to the paper's environment prefix.
ENVIRONMENTS = {"ring": "testbed", "bypass-v2": "v2", "rotating-v3": "v3"}


@dataclass(frozen=True)
class Mechanism:
    """What couples the heads of one run.

    Attributes:
        environment: ``"testbed"``, ``"v2"``, ``"v3"``, or ``""`` for labels from elsewhere.
        n_modes: Number of modes K.
        representation: Representation map of head A (``"nullspace"``, ...), empty on the robots.
        beta: Source-noise coupling, 1 private, 0 shared.
        alignment: What the heads' shared noise goes through, None for coordinate by coordinate.
        token: None, ``"oracle"``, ``"window"`` or ``"episode"``.
        n_tokens: Number of tokens.
        learned_draw: Whether tokens are drawn from a learned distribution rather than uniformly.
        consistency: Endpoint-consistency weight lambda.
        latent: None, ``"prior"`` or ``"posterior"``.
        latent_dim: Dimension of the latent; 0 is the anchor.
        kl_weight: KL weight of the posterior.
        free_bits: Its free bits, nats a dimension.
        reference: Whether the run is the exact (or moment-matched) reference rather than a trained policy.
        largest_prior: Largest mode probability of the data, NaN where it is unknown.
        standard: False if the setting (priors, spacing, spread, coupling of tokens, a third head) is not that of the
            paper's main tables.
    """

    environment: str
    n_modes: int
    representation: str
    beta: float
    alignment: str | None
    token: str | None
    n_tokens: int
    learned_draw: bool
    consistency: float
    latent: str | None
    latent_dim: int
    kl_weight: float
    free_bits: float
    reference: bool
    largest_prior: float
    standard: bool

    @property
    def family(self) -> str:
        """Family in the paper's words, without environment; empty if it has none."""
        return self._family() if self.standard else ""

    def _family(self) -> str:
        if self.token is not None:
            return self._token_family()
        if self.latent == "posterior":
            name = f"posterior kl{self.kl_weight:g}"
            if self.environment != "testbed":
                return "E posterior all"
            return name + (f" fb{self.free_bits:g}" if self.free_bits else "")
        if self.latent == "prior":
            return "C zs dim0 anchor" if self.latent_dim == 0 else "D continuous zs prior"
        if self.consistency > 0:
            if self.environment == "v3":
                return f"G consistency lambda{self.consistency:g}" if self.beta == 0 else ""
            name = f"consistency beta{self.beta:g} lambda{self.consistency:g}"
            letter = {"consistency beta0 lambda0.3": "F ", "consistency beta0 lambda3": "G "}
            return letter.get(name, "") + name if self.environment == "v2" else name
        return {1.0: "A independent", 0.0: "B shared source noise"}.get(self.beta, "")

    def _token_family(self) -> str:
        draw = "learned prior" if self.learned_draw else "uniform"
        if self.environment == "testbed":
            return {"oracle": f"oracle token {draw}", "window": "kmeans token"}.get(self.token or "", "")
        if self.token == "oracle":
            return "K oracle"
        if self.token == "episode":
            return f"I episode token {draw}" if self.learned_draw else "H episode token uniform"
        if self.n_tokens == 4:
            return "window token k4"
        return "Jp window token k2 lambda0.1" if self.consistency > 0 else "J window token k2 uniform"

    @property
    def paper_row(self) -> str:
        """The paper's row, for example ``"testbed/kmeans token/polar"``; empty if it has none."""
        if not self.environment or not self.family:
            return ""
        row = f"{self.environment}/{self.family}"
        if self.environment != "testbed":
            return row
        by_map = ("A ", "B ", "D ", "kmeans", "oracle token uniform", "consistency beta0 lambda3")
        if self.n_modes == 2 and self.family.startswith(by_map):
            return f"{row}/{self.representation}"
        return f"{row}/K{self.n_modes}"

    @property
    def touched_row(self) -> str:
        """The paper's row, or the row of its skewed testbed that has this mechanism and prior; empty if it has none."""
        if self.paper_row or self.environment != "testbed" or not self.largest_prior > 1 / self.n_modes + 1e-9:
            return self.paper_row
        return f"testbed skew/{self._family()}/p{self.largest_prior:.2f}"


def mechanism_of(gate: Gate) -> Mechanism:
    """The mechanism of a gate written by ``dualhead evaluate``; unknown parts take the uncoupled value."""
    provenance = {**gate.provenance, **policy_provenance_of(gate)}
    settings: Mapping[str, Any] = {**provenance, **provenance.get("config", {})}
    coupling = provenance.get("coupling", {})
    beta = coupling.get("source_noise_beta")
    beta = settings.get("source_noise_beta", 1.0) if beta is None else beta
    dataset = provenance.get("dataset", {}).get("env_kwargs", {})
    kinematic_map = str(
        settings.get("kinematic_map") or (settings.get("representation") or {}).get("kinematic_map", "")
    )
    probabilities = gate.target_probabilities
    balanced = probabilities is None or abs(probabilities - 1 / gate.n_modes).max() < 1e-9
    standard = balanced and coupling.get("share_token", True) and dataset.get("mode_angles") is None
    standard = standard and dataset.get("path_spread", 0.08) == 0.08
    # The paper's rows are sampled under test conditions, not recorded in closed loop.
    standard = standard and "rollouts" not in provenance
    # Their heads share noise coordinate by coordinate.
    alignment = coupling.get("source_noise_alignment") or settings.get("source_noise_alignment")
    standard = standard and alignment is None
    # Nor are an ensemble's members two heads.
    standard = standard and "members" not in provenance
    # Nor are they two draws of one head, or of LeRobot's other policies.
    standard = standard and provenance.get("method") not in (DRAWS, POLICY_PAIR)
    # The third head's runs (tab:pose) are no rows of tab:v3.
    standard = standard and not settings.get("rotation_head", False)
    return Mechanism(
        environment=ENVIRONMENTS.get(str(gate.partition.get("name")), ""),
        n_modes=gate.n_modes,
        representation=kinematic_map.partition("/")[2],
        beta=float(beta),
        alignment=alignment,
        token=settings.get("token"),
        n_tokens=int(settings.get("n_tokens") or gate.n_modes),
        learned_draw=(coupling.get("token_draw") or settings.get("token_draw", "uniform")) != "uniform",
        consistency=float(settings.get("consistency_weight") or 0.0),
        latent=settings.get("latent"),
        latent_dim=int(settings.get("latent_dim") or 0),
        kl_weight=float(settings.get("kl_weight") or 0.0),
        free_bits=float(settings.get("free_bits") or 0.0),
        reference="reference" in str(provenance.get("method", "")),
        largest_prior=float("nan") if probabilities is None else float(probabilities.max()),
        standard=bool(standard),
    )
