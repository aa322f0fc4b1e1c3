"""The stop drill causes faults on your robot, checks that each of them stops the robot, and keeps a
certificate.

``strands-actors drill so101 --port /dev/ttyACM0`` runs the drill. ``Robot(..., require_drill="30d")`` refuses
motion unless there is a certificate that is at most 30 days old. The certificate must be of the same robot
configuration and the same code.
"""
