"""Run the robot classes of LeRobot in this package: ``Robot(name, driver="lerobot", ...)``."""
