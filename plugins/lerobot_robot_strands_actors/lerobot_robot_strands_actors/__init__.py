"""Offer the robots of strands-actors as robots of LeRobot.

LeRobot imports this package because its distribution's name begins with ``lerobot_robot_``. For a config
``XConfig`` it looks for the class ``X`` in this module.
"""

from .made import all_made, robots

robots_of_lerobot = all_made(__name__)
globals().update(robots_of_lerobot)

__all__ = [*robots_of_lerobot, "robots"]  # The names of the generated classes, and ``robots``.
