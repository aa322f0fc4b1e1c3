"""LeRobot's own robot classes under this package's tree: ``Robot(name, driver="lerobot", ...)``."""
