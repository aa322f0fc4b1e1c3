"""panda-python: move to the start pose, and to a pose beside it."""

import sys

import numpy as np
import panda_py
from panda_py import libfranka

panda = panda_py.Panda(sys.argv[1], realtime_config=libfranka.RealtimeConfig.kIgnore)
panda.move_to_start()
goal = np.array(panda.q)
goal[0] += 0.3
assert panda.move_to_joint_position(goal)
assert np.allclose(panda.q, goal, atol=0.01), panda.q
print("there:", panda.q)
