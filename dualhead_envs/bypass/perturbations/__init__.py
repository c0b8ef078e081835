"""Perturbations of the robot environments: ten ways in which an episode differs from what a policy was trained on.

``gym.make("dualhead_envs:BimodalBypass-v2", perturbation="joint_bias:0.06")`` disturbs every episode by that severity,
in the unit of its kind; ``perturbation="joint_bias@2"`` by the second of four levels. An episode begins as it does
without the perturbation from the same seed, and what is drawn beside (a direction, a moment, noise) is a function of
that seed.
"""
