"""Run the real driver of an SO-101 against its twin, which a simulation moves.

It needs no robot, no display and no download.

python examples/twin.py
"""

from __future__ import annotations

from strands_actors import Robot

# The simulation. Without ``mode="real"``, ``Robot`` simulates.
sim = Robot("so101")
# The real driver. Its wire is connected to the twin, which uses this simulation as its physics.
arm = Robot("so101", mode="real", transport="twin", sim=sim)
arm.connect_eagerly()
print(arm.send_action({"shoulder_pan": 10.0}))
