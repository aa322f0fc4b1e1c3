"""The factories of the public interface. Their signatures for editors and type checkers, by robot and
mode, are in ``robot.pyi``."""

from __future__ import annotations

from .async_robot import AsyncRobot, open_robot
from .factory import Robot
from .real_robot import RealRobot
from .sim_robot import SimRobot

__all__ = ["AsyncRobot", "RealRobot", "Robot", "SimRobot", "open_robot"]
