"""Run Unitree's simulator without a screen: ``unitree_simulator.py FOLDER``, the folder ``simulate_python``.

The bridge between MuJoCo and DDS is the vendor's, unmodified. Its main program needs a screen, so this program has
its loop instead. It begins in the model's keyframe and not at its zeros, in which the robot falls before it obeys.
"""

from __future__ import annotations

import os
import sys
import time

os.chdir(sys.argv[1])
sys.path.insert(0, sys.argv[1])

import config  # noqa: E402
import mujoco  # noqa: E402
from unitree_sdk2py.core import channel  # noqa: E402

HOST = "127.0.0.1"
channel.ChannelConfigAutoDetermine = channel.ChannelConfigHasInterface = f"""
<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface address="{HOST}" multicast="false"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>
  </General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="{HOST}"/></Peers></Discovery>
</Domain></CycloneDDS>
"""
channel.ChannelFactoryInitialize(0, "lo")

from unitree_sdk2py_bridge import UnitreeSdk2Bridge  # noqa: E402

model = mujoco.MjModel.from_xml_path(config.ROBOT_SCENE)
model.opt.timestep = config.SIMULATE_DT
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, 0)
bridge = UnitreeSdk2Bridge(model, data)
print("ready", flush=True)
due = time.perf_counter()
while True:
    mujoco.mj_step(model, data)
    due += config.SIMULATE_DT
    time.sleep(max(0.0, due - time.perf_counter()))
