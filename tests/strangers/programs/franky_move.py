"""Turn the first joint by 0.3 rad: ``franky_move.py HOST``."""

import sys

from franky import JointMotion, RealtimeConfig, ReferenceType, Robot

robot = Robot(sys.argv[1], realtime_config=RealtimeConfig.Ignore)
robot.relative_dynamics_factor = 0.1
robot.move(JointMotion([0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], ReferenceType.Relative))
print(robot.current_joint_state.position)
