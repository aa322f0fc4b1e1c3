"""Run LeRobot's own robot classes in this package's tree: ``Robot(name, driver="lerobot", ...)``."""
