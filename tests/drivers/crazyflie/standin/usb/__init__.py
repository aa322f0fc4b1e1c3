"""A stand-in for pyusb: a Crazyradio and a Crazyflie on USB, with a twin behind them over UDP.

The environment variable ``CRAZYFLIE_STANDIN`` names the twin's address, and a file for the events.
"""
