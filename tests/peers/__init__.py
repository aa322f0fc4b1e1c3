"""Peers of a robot's that need an environment of their own: ``python -m tests peers``."""
