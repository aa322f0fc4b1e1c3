"""unitree_sdk2py: stand a Go2 up, walk forwards for two seconds, and stop."""

import os
import time

from unitree_sdk2py.core import channel
from unitree_sdk2py.go2.sport.sport_client import SportClient

channel.ChannelFactoryInitialize(0)
client = SportClient()
client.SetTimeout(10.0)
client.Init()
deadline = time.monotonic() + 20
while client.BalanceStand() != 0:
    assert time.monotonic() < deadline, "it does not stand"
for _ in range(20):
    assert client.Move(0.3, 0.0, 0.0) == 0
    time.sleep(0.1)
assert client.StopMove() == 0
print("walked", flush=True)
os._exit(0)
