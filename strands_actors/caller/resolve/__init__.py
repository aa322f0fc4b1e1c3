"""From the arguments of ``Robot(...)`` to a plan of what to start. Starts nothing."""
