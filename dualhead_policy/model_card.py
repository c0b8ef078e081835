"""The model card (README.md) of a checkpoint folder: mechanism, data, tokens, protocol numbers, how to use it."""

from __future__ import annotations

from collections.abc import Mapping

from dualhead_policy.configuration_dualhead import DualheadConfig

#: ``--env.type`` of the environments, by the beginning of their id.
ENV_TYPES = {"RotatingRing": "rotating_ring", "BimodalBypass": "bimodal_bypass", "RotatingBypass": "rotating_bypass"}
TOKENS = {
    "oracle": "the demonstration's mode (family K)",
    "episode": "k-means on whole transport trajectories (families H, I)",
    "window": "k-means on the training windows' positions (family J)",
}


def mechanism_lines(config: DualheadConfig) -> list[str]:
    """What the heads share, one sentence a mechanism, with the paper's family where it has one."""
    lines = []
    if config.source_noise_beta < 1:
        how = "fully" if config.source_noise_beta == 0 else "partly"
        what = "family B" if config.source_noise_alignment is None else "through the kinematic map"
        lines.append(f"The source noise is {how} shared (beta = {config.source_noise_beta:g}, {what}).")
    if config.token is not None:
        draw = {
            "uniform": "uniformly",
            "marginal": "by their training frequency",
            "learned": "from a learned prior given the observation",
        }
        lines.append(
            f"Both heads see one of {config.n_tokens} tokens, {TOKENS[config.token]}, drawn {draw[config.token_draw]}."
        )
        if config.token_replacement_prob or config.token_null_prob:
            lines.append(
                f"In training a token is replaced by a random one with probability {config.token_replacement_prob:g} "
                f"and left out with probability {config.token_null_prob:g}."
            )
    if config.latent is not None:
        family = "E" if config.latent == "posterior" else "D" if config.latent_dim else "C"
        source = "an amortised posterior" if config.latent == "posterior" else "its prior"
        lines.append(
            f"Both heads see a latent of {config.latent_dim} dimensions, in training from {source} (family {family})."
        )
    if config.consistency_weight > 0:
        lines.append(
            f"The clean endpoints of joint and position head are pulled together through forward kinematics (lambda = "
            f"{config.consistency_weight:g}, {config.consistency_norm} norm, families F and G)."
        )
    if config.rotation_head:
        lines.append("A third head predicts the hand's orientation (6-D representation).")
    if config.rotation_consistency_weight > 0:
        lines.append(
            "Joint and rotation head are pulled together by the squared geodesic angle (weight "
            f"{config.rotation_consistency_weight:g})."
        )
    return lines or ["The heads share nothing but the condition encoder (family A)."]


def model_card(
    config: DualheadConfig,
    *,
    step: int,
    token_usage: list[float] | None,
    results: Mapping[str, float | str] | None = None,
) -> str:
    """The card's Markdown, with the metadata block of model hubs.

    Args:
        config: The policy's configuration.
        step: Training steps done.
        token_usage: Frequency of every token in training, or None without tokens.
        results: Protocol numbers by name, for example valid-pair rate and rho, where they are known.
    """
    layout = config.representation
    name = config.environment or "an unnamed environment"
    on_hub = config.dataset_name is not None and not config.dataset_name.startswith("local/")
    lines = ["---", "license: mit", "library_name: lerobot", "pipeline_tag: robotics", "tags:"]
    lines += [f"- {tag}" for tag in ("robotics", "lerobot", "dualhead", "flow-matching")]
    lines += ["datasets:", f"- {config.dataset_name}"] if on_hub else []
    lines += ["---", "", f"# Dual-head policy for {name}", ""]
    lines += [
        "One predicted motion, decoded twice by flow matching: into joint space and into end-effector space. A plugin "
        "policy for LeRobot (`--policy.type=dualhead`).",
        "",
        "## Mechanism",
        "",
        *(f"- {line}" for line in mechanism_lines(config)),
        "",
        "## Training",
        "",
        f"- Dataset: {config.dataset_name or 'not recorded'} ({name})",
        f"- Steps: {step}, seed {config.seed}",
        f"- Chunk: {config.chunk_size} actions, {config.n_action_steps} executed; {config.num_inference_steps} Euler "
        "steps",
        f"- Action: {len(layout.names) if layout else '?'} dimensions, kinematic map "
        f"`{layout.kinematic_map if layout else '?'}`; physical units (rad, m), rotations as the first two columns of "
        "the grip site's matrix in the world frame",
    ]
    if token_usage is not None:
        lines += ["", "## Tokens", "", f"- Usage in training: {' / '.join(f'{share:.3f}' for share in token_usage)}"]
        if config.token_nmi is not None:
            lines.append(f"- Normalised mutual information with the demonstrations' modes: {config.token_nmi:.4f}")
        if config.token == "window":
            lines.append("- The paper's window tokens (K = 2, v2): usage .674 / .326, mutual information .1717")
    if results:
        lines += ["", "## Protocol numbers", "", "| quantity | value |", "| --- | --- |"]
        lines += [
            f"| {quantity} | {value if isinstance(value, str) else format(value, '.4g')} |"
            for quantity, value in results.items()
        ]
    lines += [
        "",
        "## Use",
        "",
        "```bash",
        "pip install lerobot_policy_dualhead",
        *_evaluation_command(config),
        "```",
        "",
    ]
    lines += [
        "```python",
        "from dualhead_policy.pretrained import load_policy",
        "",
        'policy, preprocess = load_policy("path/to/this/folder")',
        "samples = policy.sample(preprocess(observation), 64)  # .joint (B, 64, H, d) rad, .position (B, 64, H, 3) m",
        "```",
        "",
    ]
    return "\n".join(lines)


def _evaluation_command(config: DualheadConfig) -> list[str]:
    family, _, number = (config.environment or "").partition("-v")
    env_type = ENV_TYPES.get(family)
    if env_type is None:
        return []
    options = ["--policy.path=path/to/this/folder", f"--env.type={env_type}"]
    layout = config.representation
    if layout is not None and layout.ring_map is not None:
        options += [f"--env.n_modes={number}", f"--env.representation={layout.ring_map}"]
    return [" ".join(["lerobot-eval", *options, "--env.control=position", "--policy.device=cpu"])]
