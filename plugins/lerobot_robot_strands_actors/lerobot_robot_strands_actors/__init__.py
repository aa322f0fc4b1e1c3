"""The robots of strands-actors as robots of LeRobot, which imports this package because of its
distribution's name, and looks for the class ``X`` of a config ``XConfig`` right here."""

from .made import all_made, robots

robots_of_lerobot = all_made(__name__)
globals().update(robots_of_lerobot)

__all__ = [*robots_of_lerobot, "robots"]  # names of classes
