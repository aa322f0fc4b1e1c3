"""Everything that this package uses of LeRobot. Another version of LeRobot may need a change here only.

LeRobot itself uses these names of this package's classes: the config's name without ``Config`` is the name of the
robot's class, ``config_class`` and ``name``, and the methods and properties of LeRobot's ``Robot``.
"""

from lerobot.cameras import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.robots import Robot, RobotConfig

__all__ = ["CameraConfig", "Robot", "RobotConfig", "make_cameras_from_configs"]
