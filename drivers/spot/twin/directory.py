"""Keep the directory of the simulated Spot: its own services, and those that users' programs register."""

from __future__ import annotations

from collections.abc import Callable

from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message

from .faults import CRITICAL
from .login import OPEN_SERVICES

REFUSED = 2
"""Status of a registration of a name that is taken, and of a change of a service that does not exist."""
LIVENESS = "liveness"
"""Name of the fault of a service whose program is silent [assumed]."""


class Directory:
    """The directory and the registration of services.

    Args:
        robot_ns: The robot's clock.
    """

    def __init__(self, robot_ns: Callable[[], int]) -> None:
        self._robot_ns = robot_ns
        self._own = {service: _entry(service) for service in p.SERVICES}
        self._registered: dict[str, Message] = {}

    def entries(self) -> list[Message]:
        return [*self._own.values(), *self._registered.values()]

    def entry(self, name: str) -> Message:
        """Return the reply to ``GetServiceEntry``."""
        entry = next((one for one in self.entries() if one["name"] == name), None)
        return {"status": REFUSED} if entry is None else {"status": p.OK, "service_entry": entry}

    def register(self, request: Message, is_new: bool) -> Message:
        """Return the reply to ``RegisterService`` or, for an entry that is not new, to ``UpdateService``."""
        entry = request.get("service_entry", {})
        name, now = entry.get("name", ""), p.stamp(self._robot_ns())
        if not name or name in self._own or (name in self._registered) is is_new:
            # The vendor's client registers its service again and again as its heartbeat.
            if name in self._registered:
                self._registered[name]["last_update"] = now
            return {"status": REFUSED}
        self._registered[name] = {**entry, "last_update": now}
        return {"status": p.OK}

    def unregister(self, name: str) -> Message:
        return {"status": REFUSED if self._registered.pop(name, None) is None else p.OK}

    def clear(self) -> None:
        """Forget the registered services, as after a boot [assumed]."""
        self._registered.clear()

    def liveness_faults(self) -> list[Message]:
        """Return a fault for each registered service that was not updated in time."""
        return [
            {
                "fault_id": {"fault_name": LIVENESS, "service_name": name},
                "error_message": f"{name} is silent",
                "severity": CRITICAL,
            }
            for name, entry in self._registered.items()
            if 0
            < entry.get("liveness_timeout_secs", 0.0) * p.NS
            < self._robot_ns() - p.stamp_ns(entry["last_update"])
        ]


def _entry(service: str) -> Message:
    return {
        "name": service,
        "type": f"bosdyn.api.{p.SERVICES[service]}",
        "authority": p.AUTHORITIES.get(service, p.AUTHORITIES["directory"]),
        "user_token_required": service not in OPEN_SERVICES,
    }


__all__ = ["Directory"]
