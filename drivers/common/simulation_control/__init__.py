"""A twin's second simulation control: its process as a simulation.

On the wire a twin is the robot; here it is the world around it: targets without gates, positions
without noise, pictures, a fresh start. A unix socket, one request at a time a client, any number of
clients.
"""
