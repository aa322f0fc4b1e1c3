"""SAF-002: no service of any driver energises a robot that was stopped. Only a resume does.

A driver declares with ``Service.powers`` that a service energises motors, or lets them move. Then the gate refuses
the service until a resume, as it refuses a setpoint. ``RELEASES`` has the exceptions, each with its reason.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import pytest

from strands_actors.contract.driver import Driver, Reason, Service
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.admission import Admission, GateSnapshot
from strands_actors.supervisors.gate.failsafe import Mode, State
from strands_actors.supervisors.gate.lease import Leases
from strands_actors.supervisors.gate.messages import Acquire, Perform
from tests.agents.test_one_vocabulary import DRIVERS
from tests.motion.robots import NOW_NS, observed

_RELEASES_JOINTS = "It ends the controller that moves the joints."

RELEASES: Mapping[str, Mapping[str, str]] = {
    "unitree_go2": {"release_sport_mode": _RELEASES_JOINTS},
    "b2": {"release_sport_mode": _RELEASES_JOINTS},
    "unitree_h1": {"release_sport_mode": _RELEASES_JOINTS},
    "unitree_h1_2": {"release_sport_mode": _RELEASES_JOINTS},
    "reachy_mini": {"motors(mode='disabled')": "It takes the torque away."},
    "microduck": {
        "disable": "It ends the policy that moves the joints.",
        "relax": "It takes the torque away.",
        "reboot_motors": "It takes the torque away.",
        "theremin(active=False)": "It ends the motion of the mouth.",
    },
}
"""Robot to service to the reason why a stopped robot may run it, although it switches power."""

ENERGISES = re.compile(
    r"\b(torque|power|energis|enable|activate|unlock|take ?off|wake|stand|rise|get up|arm the|lets? .* move)", re.I
)
"""Words by which a service says that it energises."""

SERVICES = [(robot, name) for robot, driver in DRIVERS.items() for name in driver.SERVICES]
POWERING = [(robot, name) for robot, name in SERVICES if DRIVERS[robot].SERVICES[name].powers]

SAMPLES: Mapping[str, Mapping[str, Any]] = {
    "init": {"confirm": True},
    "relax": {"confirm": True},
    "reboot_motors": {"confirm": True},
    "set_mode": {"mode": "roller"},
    "load_policy": {"slot": "walk"},
    "do": {"skill": "kick_left"},
    "look_at": {"x": 1.0, "y": 0.2},
    "express": {"move": "yes1"},
    "play_move": {"move": "yes1"},
    "change_mode": {"mode": "prepare"},
}
"""Arguments without which a driver refuses a service before the gate looks at the robot."""


def asked(driver: Driver, mode: Mode, service: str, arguments: Mapping[str, Any]) -> Refused | None:
    """Return the gate's refusal of a service, whose caller holds the lease."""
    leases = Leases(0)
    lease = leases.acquire(Acquire("test", 0), NOW_NS)
    assert isinstance(lease, int)
    state = State(mode, 5)
    reading = observed(driver)
    snapshot = GateSnapshot(
        state, leases, "stop by test", Reason.STOP, "", reading, reading.position, NOW_NS, None, False
    )
    return Admission(driver).service(Perform(lease, 5, service, dict(arguments)), snapshot, NOW_NS)


def variants(service: Service) -> list[dict[str, Any]]:
    """Return the arguments to try: the defaults, and the values with which the service only releases."""
    values = service.releases if isinstance(service.releases, Mapping) else {}
    return [{}, *({name: value} for name, value in values.items())]


def spelled(name: str, arguments: Mapping[str, Any]) -> str:
    return name + (f"({', '.join(f'{key}={value!r}' for key, value in arguments.items())})" if arguments else "")


@pytest.mark.parametrize(("robot", "name"), POWERING)
@pytest.mark.parametrize("mode", [Mode.DISARMED, Mode.UNCONFIRMED])
def test_saf_002_a_service_that_energises_is_refused_until_a_resume(robot: str, name: str, mode: Mode) -> None:
    driver = DRIVERS[robot]
    for arguments in variants(driver.SERVICES[name]):
        given = {**SAMPLES.get(name, {}), **arguments}
        assert asked(driver, Mode.ARMED, name, given) is None, "an armed robot runs it"
        refused = asked(driver, mode, name, given)
        if spelled(name, arguments) in RELEASES.get(robot, {}):
            assert refused is None
        else:
            assert refused is not None and refused.code == "disarmed", spelled(name, arguments)
            assert refused.text.startswith(f"{name}: the robot is {mode}") and "resume()" in refused.remedy


def test_there_are_such_services_and_every_exception_exists() -> None:
    assert {("crazyflie", "takeoff"), ("spot", "stand"), ("reachy_mini", "motors"), ("microduck", "init")} <= set(
        POWERING
    )
    found = {
        (robot, spelled(name, arguments))
        for robot, name in POWERING
        for arguments in variants(DRIVERS[robot].SERVICES[name])
        if not DRIVERS[robot].SERVICES[name].arms(arguments)
    }
    assert found == {(robot, service) for robot, services in RELEASES.items() for service in services}


@pytest.mark.parametrize(("robot", "name"), SERVICES)
def test_saf_002_a_service_that_says_that_it_energises_is_declared_so(robot: str, name: str) -> None:
    service = DRIVERS[robot].SERVICES[name]
    declared = service.powers or service.moves or service.acts or service.ends_motion or service.stops is not None
    says = ENERGISES.search(name.replace("_", " ")) or ENERGISES.search(service.about)
    assert declared or not says, service.about


def test_a_release_has_a_default_of_its_argument_that_energises() -> None:
    for robot, name in POWERING:
        service = DRIVERS[robot].SERVICES[name]
        if isinstance(service.releases, Mapping):
            assert service.releases.keys() <= service.arguments.keys()
            assert service.arms({}), "left out, the argument energises"
