"""The two robot environments: a Panda carries a cube past an obstacle, one of two ways.

``BimodalBypass-v2`` passes a wall on the left or on the right; ``RotatingBypass-v3`` passes a suspended beam on
one of two azimuths that each condition draws anew. Geometry and constants: :mod:`dualhead_envs.bypass.task`.
Nothing here is imported by ``import dualhead_envs``: MuJoCo loads when an environment is made.
"""
