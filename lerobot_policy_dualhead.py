"""LeRobot's door to this package.

LeRobot imports the module named like every installed distribution whose name starts with
``lerobot_policy_``. Importing the two configuration modules registers ``--policy.type=dualhead`` and the
``--env.type`` choices, that of the certificate's step its name in a policy's processors; every LeRobot command pays for
this import, so nothing heavier happens here.
"""

import dualhead_envs.lerobot_envs  # noqa: F401
import dualhead_eval.certificate_step  # noqa: F401
import dualhead_policy.configuration_dualhead  # noqa: F401
