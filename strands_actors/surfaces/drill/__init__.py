"""The stop drill: on the robot in front of you, prove that it can be stopped, and keep a
certificate of it.

``strands-actors drill so101 --port /dev/ttyACM0`` runs it; ``Robot(..., require_drill="30d")``
refuses motion without a certificate that is fresh and matches the robot's configuration and the
code that keeps it safe.
"""
