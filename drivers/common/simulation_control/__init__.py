"""A second interface of a simulated robot, by which a program uses it as a simulation.

In its real protocol (the "wire") a simulated robot behaves like the robot. This interface controls the world around
it: targets without checks, positions without noise, pictures, a reset. It is a unix socket for any number of
clients. Each client sends one request at a time.
"""
