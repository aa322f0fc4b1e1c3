"""Connections to robots. Each write is handed over at once or raises, and each wait has a deadline."""
