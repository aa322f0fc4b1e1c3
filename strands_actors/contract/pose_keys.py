"""The keys of a tool's pose in actions and readings, as LeRobot's kinematic processors name them.

The position is in metres. The orientation is a rotation vector in radians: its direction is the axis of the turn,
and its length the angle. ``ee.gripper_pos`` is the position of the gripper in the unit of its axis.
"""

POSITION_KEYS = ("ee.x", "ee.y", "ee.z")
TURN_KEYS = ("ee.wx", "ee.wy", "ee.wz")
POSE_KEYS = (*POSITION_KEYS, *TURN_KEYS)
GRIPPER_KEY = "ee.gripper_pos"
PREFIX = "ee."


__all__ = ["GRIPPER_KEY", "POSE_KEYS", "POSITION_KEYS", "PREFIX", "TURN_KEYS"]
