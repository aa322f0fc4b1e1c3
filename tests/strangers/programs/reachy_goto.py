"""reachy-mini: move the head and the antennas to a pose, and back."""

import sys

import numpy as np
from reachy_mini import ReachyMini
from reachy_mini.utils import create_head_pose

host, port = sys.argv[1:3]
with ReachyMini(host=host, port=int(port), media_backend="no_media") as mini:
    mini.goto_target(head=create_head_pose(yaw=20, degrees=True), antennas=np.deg2rad([30, 30]), duration=1.0)
    _, antennas = mini.get_current_joint_positions()
    assert np.allclose(antennas, np.deg2rad([30, 30]), atol=0.1), antennas
    print("there:", antennas)
