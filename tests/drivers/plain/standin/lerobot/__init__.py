"""Stand-in for the parts of LeRobot 0.4.4 that ``driver="lerobot"`` uses: the names, and the effect of their
calls on motors."""
