"""What can happen in a run, and how often: who asks what, what befalls a process, what a wire does."""

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
"""What a process cannot get any more: it opens, duplicates or starts nothing."""
EXHAUSTED = ("root", "wire", "standby")
MOMENTS = {
    "caller": ("Resumed", "Lease", "Accepted", "StopReport"),
    "root": ("StateIs", "Handover", "Shutdown", "Fence", "StopTask"),
    "wire": ("Resume", "Setpoint", "Perform", "Stop"),
    "policy": ("Accepted",),
}
"""By process: the messages that begin what a fault may fall into."""
MOST_STEPS = 7
"""As a power of two."""
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
SESSION = {  # of a stream: nothing is lost or doubled, but held up
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
"""What a peer does that is broken or hostile. ``babble``: noise in place of each answer; ``half
frame``: each answer ends in its middle, and no further one comes; ``old answers``: the one before in
place of each; ``unasked``: old ones beside the true ones; ``flood``: so many that a reader is busy;
``refuse``: it resets each connection during its handshake."""
PEER_TALKS = tuple(kind for kind in PEER if kind != "refuse")
"""Those that leave the robot able to hear."""
CONDITIONS = {"low battery": 2}
SERVICE = {"slow service": 3, "out of reach": 3}
WIRE_FAULTS: dict[str, dict[str, int]] = {
    "so101": {**BUS, **BUS_PEER},
    "xarm7": {**SESSION, **STREAM_PEER},
    "ur5e": {**SESSION, **STREAM_PEER},
    "ur5e_script": {**SESSION, **STREAM_PEER},
    "unitree_go2": {**NETWORK, **NETWORK_PEER, **CONDITIONS},
    "fake_base": SERVICE,
    "fake_drone": {**SERVICE, **CONDITIONS},
    "fake_http": SERVICE,
    "fake_queue": SERVICE,
}
"""By robot: what its wire does, and how often."""
AT_A_POINT = ("unload", "brown out", "reset")
"""What has no end."""
SHORT_S = (0.002, 0.02, 0.06, 0.15, 0.3, 0.7)
