"""unitree_sdk2py: a gesture of a G1 that stands by its own controller, and back."""

import os
import time

from unitree_sdk2py.core import channel
from unitree_sdk2py.g1.arm.g1_arm_action_client import G1ArmActionClient, action_map

channel.ChannelFactoryInitialize(0)
client = G1ArmActionClient()
client.SetTimeout(10.0)
client.Init()
deadline = time.monotonic() + 20
while client.ExecuteAction(action_map["shake hand"]) != 0:
    assert time.monotonic() < deadline, "no gesture"
time.sleep(3.0)
assert client.ExecuteAction(action_map["release arm"]) == 0
time.sleep(2.0)
print("shook hands", flush=True)
os._exit(0)
