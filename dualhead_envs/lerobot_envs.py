"""LeRobot's ``--env.type`` choices of this package: importing this module registers them.

They live beside the environments because LeRobot's asynchronous workers start with an empty registry and
import what they unpickle: a configuration's module must bring the ids along.
"""

from dualhead_envs.bypass.lerobot_bypass import BimodalBypassConfig, RotatingBypassConfig
from dualhead_envs.ring.lerobot_ring import RotatingRingConfig

__all__ = ["BimodalBypassConfig", "RotatingBypassConfig", "RotatingRingConfig"]
