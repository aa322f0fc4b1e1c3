"""The lease and the e-stop of the simulated Spot."""

from __future__ import annotations

from collections.abc import Callable

from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message

EPOCH = "twin"
_STEP = 7
"""Difference between one challenge and the next."""


class Leases:
    """The lease of the simulated Spot's body, the right to command it."""

    def __init__(self) -> None:
        self.owner = ""
        self._number = 0
        self._newest: list[int] = []

    def acquire(self, client: str, take: bool = False) -> Message:
        """Return the reply to a request for the lease: the lease, or its present owner."""
        if self.owner and not take:
            return {"status": p.LEASE_CLAIMED, "lease_owner": {"client_name": self.owner}}
        self._number += 1
        self.owner, self._newest = client, [self._number]
        lease = {
            "resource": p.LEASE_RESOURCE,
            "epoch": EPOCH,
            "sequence": [self._number],
            "client_names": [client],
        }
        return {"status": p.OK, "lease": lease, "lease_owner": {"client_name": client}}

    def give_back(self, lease: Message) -> int:
        """Take back the lease that a client returns. Return the status of the reply. The status 3
        means that this lease is not in force."""
        if not self.owner or lease.get("sequence", [])[:1] != [self._number]:
            return 3
        self.owner = ""
        return p.OK

    def use(self, lease: Message) -> Message:
        """Return the field of a reply that shows whether the robot accepts the lease of the
        request."""
        result = {
            "status": int(self._status(lease)),
            "owner": {"client_name": self.owner},
            "attempted_lease": lease,
        }
        if result["status"] == p.LeaseUse.OK:
            self._newest = list(lease["sequence"])
        return result

    def listed(self) -> Message:
        return {
            "resource": p.LEASE_RESOURCE,
            "lease": {"resource": p.LEASE_RESOURCE, "epoch": EPOCH, "sequence": self._newest},
            "lease_owner": {"client_name": self.owner},
        }

    def _status(self, lease: Message) -> p.LeaseUse:
        sequence: list[int] = lease.get("sequence", [])
        if not sequence or lease.get("resource") != p.LEASE_RESOURCE:
            return p.LeaseUse.INVALID_LEASE
        if lease.get("epoch") != EPOCH:
            return p.LeaseUse.WRONG_EPOCH
        if not self.owner or sequence[0] != self._number:
            return p.LeaseUse.REVOKED
        return p.LeaseUse.OK if sequence >= self._newest else p.LeaseUse.OLDER


class _Endpoint:
    """One registered e-stop endpoint."""

    def __init__(self, endpoint: Message, now_s: float) -> None:
        self.endpoint = endpoint
        self.level = p.StopLevel.CUT
        self.checked_in_s = now_s
        self.challenge = 1000

    def level_at(self, now_s: float) -> p.StopLevel:
        """Return the e-stop level that this endpoint requests. Without a recent check-in, it
        requests that the robot sits down and cuts its motors."""
        late = now_s - self.checked_in_s > p.stamp_ns(self.endpoint.get("timeout", {})) / p.NS
        return min(self.level, p.StopLevel.SETTLE_THEN_CUT) if late else self.level


class Estop:
    """The simulated e-stop: its endpoints, and a button on the robot."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._endpoints: dict[str, _Endpoint] = {}
        self._configs = 0
        self.config: Message = {}
        self.pressed = False

    @property
    def level(self) -> p.StopLevel:
        """Return the robot's e-stop level: the most severe level of all endpoints and the button."""
        levels = [end.level_at(self._now_s()) for end in self._endpoints.values()]
        if self.pressed or not levels:
            return p.StopLevel.CUT
        return min(levels)

    def set_config(self, requested: Message, target: str, motors_on: bool) -> Message:
        if motors_on:
            return {"status": 4, "active_config": self.config}
        if self.config and target != self.config["unique_id"]:
            return {"status": 2, "active_config": self.config}
        self._configs += 1
        self._endpoints.clear()
        number = self._configs
        endpoints = [
            {**endpoint, "unique_id": f"endpoint-{number}-{index}"}
            for index, endpoint in enumerate(requested.get("endpoints", []))
        ]
        self.config = {"endpoints": endpoints, "unique_id": f"config-{number}"}
        return {"status": p.OK, "active_config": self.config}

    def register(self, new: Message, target: str) -> Message:
        if target != self.config.get("unique_id"):
            return {"status": 3, "new_endpoint": new}
        configured = next(
            (candidate for candidate in self.config["endpoints"] if candidate.get("role") == new.get("role")), None
        )
        if configured is None:
            return {"status": 2, "new_endpoint": new}
        endpoint = {**new, "unique_id": configured["unique_id"]}
        self._endpoints[endpoint["unique_id"]] = _Endpoint(endpoint, self._now_s())
        return {"status": p.OK, "new_endpoint": endpoint}

    def deregister(self, target: Message, motors_on: bool) -> int:
        if motors_on:
            return 4
        return p.OK if self._endpoints.pop(target.get("unique_id", ""), None) else 2

    def check_in(self, request: Message) -> Message:
        end = self._endpoints.get(request.get("endpoint", {}).get("unique_id", ""))
        if end is None:
            return {"status": int(p.CheckIn.ENDPOINT_UNKNOWN)}
        challenge = request.get("challenge", 0)
        right = challenge == end.challenge and request.get("response", 0) == p.challenge_response(challenge)
        end.challenge += _STEP
        if not right:
            return {"status": int(p.CheckIn.INCORRECT_CHALLENGE_RESPONSE), "challenge": end.challenge}
        end.checked_in_s = self._now_s()
        end.level = p.StopLevel(request.get("stop_level", 1))
        return {"status": int(p.CheckIn.OK), "challenge": end.challenge}

    def status(self) -> Message:
        now_s = self._now_s()
        endpoints = [
            {
                "endpoint": end.endpoint,
                "stop_level": int(end.level_at(now_s)),
                "time_since_valid_response": p.duration(now_s - end.checked_in_s),
            }
            for end in self._endpoints.values()
        ]
        return {"endpoints": endpoints, "stop_level": int(self.level)}
