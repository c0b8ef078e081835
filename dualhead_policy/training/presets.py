"""Named training budgets; every value can be overridden on the command line."""

from __future__ import annotations

#: Flags that a preset stands for.
PRESETS: dict[str, dict[str, str]] = {
    # The demo and tests: minutes on two cores.
    "smoke": {"steps": "3000", "batch_size": "128", "save_freq": "1000"},
    # Large enough to hold trained networks against the exact reference.
    "full": {"steps": "20000", "batch_size": "128", "save_freq": "5000"},
    # sec:models: 50,000 steps of batch 128 at 3e-4; network, exact observations and unpadded windows as in the paper.
    "paper": {
        "steps": "50000",
        "batch_size": "128",
        "save_freq": "5000",
        "policy.optimizer_lr": "3e-4",
        "policy.lr_schedule": "constant",
        "policy.conditioning": "concat",
        "policy.preconditioning": "none",
        "policy.observation_noise": "0",
        "policy.padded_steps": "0",
    },
}
