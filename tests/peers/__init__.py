"""Tests with peers of robots that need a separate environment: ``python -m tests peers``."""
