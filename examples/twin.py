"""Run the real driver of an SO-101 against a simulated arm.

The example needs no robot, no display and no download.

python examples/twin.py
"""

from __future__ import annotations

from strands_actors import Robot

# Without ``mode="real"``, ``Robot`` makes a simulation.
sim = Robot("so101")
# This robot uses the real driver. The driver's serial protocol goes to the simulated arm of ``sim``.
arm = Robot("so101", mode="real", transport="twin", sim=sim)
arm.connect_eagerly()
print(arm.send_action({"shoulder_pan": 10.0}))
