"""Find the only T1 on a network. This is used when no address was given."""

from __future__ import annotations

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.network_interfaces import address_of
from strands_actors.drivers.common.rtps import MULTICAST_GROUP, Participant, own_address

from . import protocol as p

FIND_S = 5.0
"""Time for the first robot to answer."""
OTHERS_S = 1.0
"""Time for a second robot to answer. With two, the choice would be a guess."""
LOOK_S = 0.05


async def find_robot(domain: int, interface: str, robot_name: str) -> str:
    """Return the address of the only robot that publishes its state in this DDS domain.

    Args:
        domain: DDS domain of the robot.
        interface: Name or address of the host's network interface; empty for the default route.
        robot_name: The name that the robot's topics contain; empty if they contain none.

    Raises:
        WireDown: No robot answers, or several do: commands would reach all of them.
    """
    try:
        participant = Participant(domain, address_of(interface) if interface else own_address(MULTICAST_GROUP))
    except ValueError as error:
        raise WireDown(f"booster: {error}. Give the robot's address with port=") from None
    states = participant.reader(p.topic("low_state", robot_name), p.STATE_TYPE, lambda *_: None)
    try:
        with trio.move_on_after(FIND_S):
            while not states.hosts:
                await _look(participant)
        with trio.move_on_after(OTHERS_S if states.hosts else 0.0):
            while True:
                await _look(participant)
        addresses = states.hosts
    finally:
        participant.close()
    if len(addresses) == 1:
        return addresses[0]
    if addresses:
        raise WireDown(
            f"booster: several robots answer: {', '.join(sorted(addresses))}. Give the address of one with port="
        )
    name = f" called {robot_name!r}" if robot_name else ""
    raise WireDown(f"booster: no robot{name} answers in domain {domain}. Give the robot's address with port=")


async def _look(participant: Participant) -> None:
    participant.poll()
    await trio.sleep(LOOK_S)
