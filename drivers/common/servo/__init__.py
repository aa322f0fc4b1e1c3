"""The code that all robots with position servos on a serial bus share.

The ``protocol`` module of each servo family provides the functions and constants of ``Codec``.
"""
