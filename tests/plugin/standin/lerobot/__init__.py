"""A stand-in for LeRobot 0.4.4 and 0.6.1 with the names that the plugin uses, and their behaviour."""
