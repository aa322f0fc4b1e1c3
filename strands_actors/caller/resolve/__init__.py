"""Turn the arguments of ``Robot(...)`` into a plan of the processes to start. No process is started here."""
