"""List the places of the safety code, and the tests of each, the quickest first."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]

MACHINE = ("tests/tree/test_failsafe.py", "tests/tree/test_machine.py")
TREE = ("tests/tree",)
CONFORMANCE = "tests/drivers/test_conformance.py"
FIRST_FRAME = "tests/hostile/test_first_frame.py"
HOSTILE = "tests/hostile/test_virtual.py"
KILL = "tests/kill"
STOPS = (
    "make_safe",
    "reach",
    "confirm",
    "confirmed",
    "is_confirmed",
    "report",
    "unconfirmed",
    "_make_safe",
    "_confirm",
    "_stop",
    "stop",
    "_halt",
    "_hold",
    "hold",
    "_tell_stop",
    "_report",
)
"""Names of the functions by which a wire stops its robot and confirms the stop."""


class Place(NamedTuple):
    """A file, its tests, and the functions in it that are mutated; empty for all functions."""

    path: str
    tests: tuple[str, ...]
    functions: tuple[str, ...] = ()


GATE = (*MACHINE, "tests/mesh/test_rules.py", *TREE)
ROOTS = (*TREE, KILL)
WIRES = {
    "booster": ("stopping.py", "stop_channel.py"),
    "crazyflie": ("stopping.py", "stop_channel.py"),
    "earthrover": ("stop.py",),
    "franka": ("stop_channel.py",),
    "kinova": ("stopping.py", "stop_channel.py"),
    "can_motors": ("stop_channel.py", "stopping.py"),
    "kuka": ("stop_channel.py", "link.py"),
    "microduck": ("stop.py",),
    "plain": ("stop_channel.py",),
    "rby1": ("stopping.py", "stop_channel.py"),
    "reachy": ("stop.py",),
    "robotiq": ("stop_channel.py",),
    "spot": ("stopping.py", "stop_channel.py"),
    "stretch": ("stop_channel.py", "safing.py"),
    "unitree": ("stop_channel.py",),
    "ur": ("stop_channel.py",),
    "xarm": ("stop_channel.py", "control.py"),
    "yahboom": ("stop.py",),
}
"""Files of each wire that stop its robot, apart from ``wire.py``."""


def _wires() -> list[Place]:
    places = []
    for wire, files in WIRES.items():
        tests = (FIRST_FRAME, f"tests/drivers/{wire}", HOSTILE)
        places.append(Place(f"drivers/{wire}/wire.py", tests, STOPS))
        places += [Place(f"drivers/{wire}/{file}", tests) for file in files]
    return places


PLACES = (
    Place("supervisors/gate/failsafe.py", GATE),
    Place("supervisors/gate/admission.py", GATE),
    Place("supervisors/gate/lease.py", GATE),
    Place("supervisors/gate/cause.py", GATE),
    Place("supervisors/gate/target_after_hold.py", GATE),
    Place("supervisors/gate/gate.py", GATE),
    Place("supervisors/wire/transport.py", ROOTS),
    Place("supervisors/wire/watchdog.py", ROOTS),
    Place("supervisors/wire/late_requests.py", ROOTS),
    Place("supervisors/root/guardian.py", ROOTS),
    Place("supervisors/root/channel_keeper.py", ROOTS),
    Place("supervisors/root/standby_keeper.py", ROOTS),
    Place("supervisors/root/stopping.py", ROOTS),
    Place("supervisors/root/stopped_detector.py", ROOTS),
    Place("supervisors/standby/decision.py", ROOTS),
    Place("supervisors/standby/watch.py", ROOTS),
    Place("supervisors/standby/process.py", ROOTS),
    Place("strands_actors/contract/axis_gates.py", ("tests/contract", "tests/drivers/feetech/test_gates.py")),
    Place("strands_actors/contract/stop_channels.py", ("tests/contract", FIRST_FRAME, HOSTILE)),
    Place("strands_actors/contract/stop_orders.py", ("tests/contract", FIRST_FRAME, HOSTILE)),
    Place("strands_actors/contract/stop_process.py", ("tests/contract", "tests/drivers/crazyflie")),
    Place("drivers/common/servo/safing.py", (FIRST_FRAME, "tests/drivers/servo", "tests/drivers/feetech", HOSTILE)),
    *_wires(),
)


def source_of(place: Place) -> str:
    return (ROOT / place.path).read_text()
