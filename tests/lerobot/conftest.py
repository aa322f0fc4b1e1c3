"""Room for machines that import torch beside the tests."""

from __future__ import annotations

import importlib.util

from strands_actors.testing import twin

# Only newer versions of LeRobot have the arms of CAN motors.
collect_ignore = [] if importlib.util.find_spec("lerobot.robots.rebot_b601_follower") else ["test_can_motors.py"]

twin.PATIENCE_S = 120.0
