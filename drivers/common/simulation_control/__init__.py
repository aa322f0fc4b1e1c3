"""The simulation control: a second interface of a twin, which serves it as a simulation.

On the wire a twin is the robot. Here it is the world around the robot: targets without gates, positions
without noise, pictures, a reset. It is a unix socket for any number of clients, each with one request
at a time.
"""
