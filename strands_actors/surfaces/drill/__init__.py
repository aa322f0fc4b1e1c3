"""The stop drill proves on your own robot that it can be stopped, and keeps a certificate of that.

``strands-actors drill so101 --port /dev/ttyACM0`` runs it. ``Robot(..., require_drill="30d")`` refuses
motion without a certificate that is recent and matches the robot's configuration and the code that keeps
it safe.
"""
