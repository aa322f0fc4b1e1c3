"""What the plugin meets of LeRobot 0.4.4 and 0.6.1, without it: the names, and what they promise."""
