"""Motions with a duration: plans for every robot, streams in virtual time, and calls from a script."""
