"""The functions and classes with which a user makes a robot.

``robot.pyi`` has their signatures for each robot and mode, for editors and type checkers.
"""

from __future__ import annotations

from .async_robot import AsyncRobot, open_robot
from .factory import Robot
from .real_robot import RealRobot
from .sim_robot import SimRobot

__all__ = ["AsyncRobot", "RealRobot", "Robot", "SimRobot", "open_robot"]
