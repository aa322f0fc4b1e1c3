"""Poses of a tool: where it is, and how it moves to another pose. Pure: no clock, no I/O."""
