"""Keep the faults of the simulated Spot: those of its hardware, of its behaviour, and of the services of its users.

A robot with a fault of its behaviour refuses every command until a client has cleared the fault ("The robot must
not have behavior faults", robot_command.proto). A fault of the behaviour that broken hardware caused cannot be
cleared while the hardware is broken.
"""

from __future__ import annotations

import enum
from collections.abc import Callable

from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message

CLEARABLE, UNCLEARABLE = 1, 2
"""Values of ``BehaviorFault.status``."""
CLEARED, NOT_CLEARED = 1, 2
"""Values of ``ClearBehaviorFaultResponse.status``."""
REFUSED = 2
"""Status of a service fault that is triggered although it is active, or cleared although it is not."""
CRITICAL = 3
"""Value of ``SystemFault.severity``."""


class Cause(enum.IntEnum):
    """Value of ``BehaviorFault.cause``."""

    FALL = 1
    HARDWARE = 2


class RobotFaults:
    """All active faults.

    Args:
        robot_ns: The robot's clock.
        silent_services: Returns the faults of services whose programs are silent.
    """

    def __init__(self, robot_ns: Callable[[], int], silent_services: Callable[[], list[Message]]) -> None:
        self._robot_ns = robot_ns
        self._silent_services = silent_services
        self._count = 0
        self._behaviour: list[Message] = []
        self._system: dict[str, Message] = {}
        self._service: list[Message] = []

    @property
    def refuses_commands(self) -> bool:
        return bool(self._behaviour)

    @property
    def is_broken(self) -> bool:
        """True while hardware is broken. Then the motors get no power."""
        return bool(self._system)

    def report(self) -> Message:
        """Return the fields of ``RobotState`` that have faults."""
        return {
            "system_fault_state": {"faults": list(self._system.values())},
            "behavior_fault_state": {"faults": self._behaviours()},
            "service_fault_state": {"faults": [*self._service, *self._silent_services()]},
        }

    def begin(self, cause: Cause) -> None:
        """Add a fault of the behaviour."""
        self._count += 1
        self._behaviour.append(
            {"behavior_fault_id": self._count, "onset_timestamp": p.stamp(self._robot_ns()), "cause": int(cause)}
        )

    def break_hardware(self, name: str) -> None:
        """Break a part, which is a fault of the behaviour too."""
        if name not in self._system:
            onset = p.stamp(self._robot_ns())
            message = f"{name} is broken"
            fault = {"name": name, "onset_timestamp": onset, "error_message": message, "severity": CRITICAL}
            self._system[name] = fault
            self.begin(Cause.HARDWARE)

    def repair(self) -> None:
        """Repair all hardware. The faults of the behaviour stay until a client clears them."""
        self._system.clear()

    def restart(self) -> None:
        """Boot. Only broken hardware is still a fault then."""
        broken = tuple(self._system)
        self._behaviour, self._system, self._service = [], {}, []
        for name in broken:
            self.break_hardware(name)

    def clear(self, number: int) -> Message:
        """Clear a fault of the behaviour. Return the fields of the reply."""
        fault = next((one for one in self._behaviours() if one["behavior_fault_id"] == number), None)
        if fault is None:
            return {"status": NOT_CLEARED}
        if fault["status"] == UNCLEARABLE:
            blocking = list(self._system.values())
            return {"status": NOT_CLEARED, "behavior_fault": fault, "blocking_system_faults": blocking}
        self._behaviour = [one for one in self._behaviour if one["behavior_fault_id"] != number]
        return {"status": CLEARED, "behavior_fault": fault}

    def trigger_service_fault(self, fault: Message) -> int:
        """Add a fault of a service that a user's program runs. Return the status of the reply."""
        name = fault.get("fault_id", {})
        if any(one["fault_id"] == name for one in self._service):
            return REFUSED
        self._service.append({**fault, "fault_id": name, "onset_timestamp": p.stamp(self._robot_ns())})
        return p.OK

    def clear_service_fault(self, request: Message) -> int:
        """Clear one fault of a service, or all of a service or a payload. Return the status of the reply."""
        name = request.get("fault_id", {})
        same = [key for key in ("service_name", "payload_guid") if request.get(_ALL_OF[key])]

        def is_meant(fault: Message) -> bool:
            active = fault["fault_id"]
            return any(active.get(key) == name.get(key) for key in same) if same else bool(active == name)

        left = [fault for fault in self._service if not is_meant(fault)]
        if len(left) == len(self._service):
            return REFUSED
        self._service = left
        return p.OK

    def _behaviours(self) -> list[Message]:
        return [
            {**fault, "status": UNCLEARABLE if self._system and fault["cause"] == Cause.HARDWARE else CLEARABLE}
            for fault in self._behaviour
        ]


_ALL_OF = {"service_name": "clear_all_service_faults", "payload_guid": "clear_all_payload_faults"}

__all__ = ["Cause", "RobotFaults"]
