"""Motion in a time: plans over every robot, streams in virtual time, and what a script sees."""
