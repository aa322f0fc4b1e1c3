"""A stand-in for pyusb: what a Crazyradio and a Crazyflie on USB do, with a twin behind them over
UDP.

``CRAZYFLIE_STANDIN`` in the environment names the twin's address, and a file that says what
happened.
"""
