"""Gymnasium environments of dual-head coordination: importing this package registers them.

``gym.make("dualhead_envs:RotatingRing-v4")`` imports and makes in one go; after ``import dualhead_envs`` the
plain id does too. The import is light: simulators and LeRobot are only loaded by the environments and
modules that need them.
"""

from dualhead_envs.registration import ENVIRONMENTS, register_environments

__all__ = ["ENVIRONMENTS"]

register_environments()
