"""Weights of the events of a run: requests, faults of processes and faults of wires.

A greater number is drawn more often.
"""

from __future__ import annotations

CALLER = "caller"
OPERATORS = ("operator", "second operator")
PROCESSES = ("caller", "root", "wire", "policy", "standby")

ASKS = {
    "stop": 4,
    "estop": 3,
    "resume": 6,
    "resume softly": 1,
    "oneshot": 4,
    "stream": 2,
    "hasty stream": 1,
    "service": 2,
    "acquire": 1,
    "release": 3,
    "status": 1,
    "start task": 3,
    "stop task": 3,
    "fence": 1,
    "cleanup": 2,
}
FAULTS = {
    "kill": 6,
    "freeze": 6,
    "lag": 2,
    "cut mesh": 1,
    "slow mesh": 1,
    "slow spawner": 2,
    "restart": 2,  # of the script, by systemd
    "attack": 2,  # by the policy process
    "leak": 1,
    "no files": 1,
    "no threads": 1,
    "no memory": 1,
}
EXHAUSTION = ("leak", "no files", "no threads", "no memory")
"""Faults after which a process cannot open or duplicate a descriptor, or cannot start anything."""
EXHAUSTED = ("root", "wire", "standby")
MOMENTS = {
    "caller": ("Resumed", "Lease", "Accepted", "StopReport"),
    "root": ("StateIs", "Handover", "Shutdown", "Fence", "StopTask"),
    "wire": ("Resume", "Setpoint", "Perform", "Stop"),
    "policy": ("Accepted",),
}
"""For each process, the messages that may have a fault while they are handled."""
MOST_STEPS = 7
"""Most steps between a message and its fault, as a power of two."""
BUS = {
    "lose replies": 4,
    "lose requests": 2,
    "mute": 5,
    "late": 1,
    "corrupt": 2,
    "twice": 1,
    "pull": 4,
    "unload": 2,
    "brown out": 1,
}
SESSION = {  # of a stream: it may delay bytes, but never loses or doubles them
    "pull": 4,
    "hold requests": 2,
    "hold replies": 3,
    "stall": 4,
    "late": 1,
    "mute": 2,
    "garble": 2,
    "reset": 3,
    "brown out": 1,
}
NETWORK = {  # of datagrams
    "lose replies": 3,
    "lose requests": 2,
    "drop": 3,
    "late": 2,
    "twice": 1,
    "corrupt": 2,
    "pull": 3,
    "stall": 3,
    "brown out": 1,
}
BUS_PEER = {"babble": 1, "half frame": 1, "old answers": 2, "unasked": 2}
STREAM_PEER = {"babble": 1, "half frame": 1, "old answers": 2, "unasked": 2, "flood": 1, "refuse": 2}
NETWORK_PEER = {"old answers": 2, "unasked": 2, "flood": 1}
PEER = (*STREAM_PEER,)
"""Faults of a broken or hostile peer.

* ``babble``: it sends noise instead of each answer.
* ``half frame``: an answer ends in its middle, and no further one follows.
* ``old answers``: it sends the previous answer instead of each answer.
* ``unasked``: it sends old answers in addition to the true ones.
* ``flood``: it sends so many copies that a reader is busy.
* ``refuse``: it resets each connection during its handshake.
"""
PEER_TALKS = tuple(kind for kind in PEER if kind != "refuse")
"""The faults of a peer with which the robot still receives frames."""
CONDITIONS = {"low battery": 2}
SERVICE = {"slow service": 3, "out of reach": 3}
TWIN_STREAMS = (
    "rby1",
    "spot",
    "yahboom_m3pro",
    "earthrover",
    "microduck",
    "reachy_mini",
    "kinova_gen3",
    "robotiq_2f85",
    "panda",
)
TWIN_DATAGRAMS = ("kuka_iiwa", "crazyflie", "booster_t1")
TWIN_PORTS = ("stretch3",)
"""The robots of the kit of ``twin_robot.py``: behind connections, at a UDP port, at serial ports."""
PORTS = {kind: weight for kind, weight in BUS.items() if kind not in ("corrupt", "twice", "unload")} | {"garble": 2}
"""Faults of several serial ports."""
PLAIN_NETWORK = {kind: weight for kind, weight in NETWORK.items() if kind != "corrupt"}
"""Faults of datagrams whose protocol has no checksum of its own. That of UDP drops a spoiled one."""
WIRE_FAULTS: dict[str, dict[str, int]] = {
    "so101": {**BUS, **BUS_PEER},
    "so101_lowered": {**BUS, **BUS_PEER},
    "xarm7": {**SESSION, **STREAM_PEER},
    "ur5e": {**SESSION, **STREAM_PEER},
    "ur5e_script": {**SESSION, **STREAM_PEER},
    "unitree_go2": {**NETWORK, **NETWORK_PEER, **CONDITIONS},
    "fake_base": SERVICE,
    "fake_drone": {**SERVICE, **CONDITIONS},
    "fake_http": SERVICE,
    "fake_queue": SERVICE,
    **{robot: {**SESSION, **STREAM_PEER} for robot in TWIN_STREAMS},
    **{robot: {**PLAIN_NETWORK, **NETWORK_PEER} for robot in TWIN_DATAGRAMS},
    **{robot: {**PORTS, **BUS_PEER} for robot in TWIN_PORTS},
}
"""By robot: the weights of the faults of its wire."""
AT_A_POINT = ("unload", "brown out", "reset")
"""Faults that happen at one moment and last no time."""
SHORT_S = (0.002, 0.02, 0.06, 0.15, 0.3, 0.7)
