"""Connections to robots: each write leaves at once or raises, and each wait has a deadline."""
