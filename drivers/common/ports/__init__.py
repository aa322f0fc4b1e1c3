"""Connections to robots. Each write gives its data to the operating system at once or raises. Each wait
has a deadline."""
