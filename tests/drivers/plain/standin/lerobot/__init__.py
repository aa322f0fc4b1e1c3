"""What ``driver="lerobot"`` meets of LeRobot 0.4.4, without it: the names, and what their calls do
to motors."""
