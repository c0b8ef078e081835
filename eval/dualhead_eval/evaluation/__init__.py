"""From samplers and conditions, or recorded rollouts, to gates."""
