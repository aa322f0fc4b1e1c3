"""A subscriber as written for strands-robots, with its keys and field names. Of this project it uses only the
note with the robot's address."""

from __future__ import annotations

import json
from typing import Any

import zenoh

from strands_actors.caller.processes.run_directory import notes
from tests.answers import until


class Subscriber:
    """A plain zenoh session that keeps the last JSON record of each topic, as strands-robots does."""

    def __init__(self) -> None:
        (note,) = notes()
        self.peer = note.robot
        config = zenoh.Config()
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("connect/endpoints", json.dumps(note.mesh))
        self._last: dict[str, dict[str, Any]] = {}
        self._session = zenoh.open(config)
        self._session.declare_subscriber(f"strands/{self.peer}/**", self._hear)

    def _hear(self, sample: zenoh.Sample) -> None:
        topic = str(sample.key_expr).removeprefix(f"strands/{self.peer}/")
        self._last[topic] = json.loads(sample.payload.to_string())

    def record(self, topic: str) -> dict[str, Any]:
        return until(lambda: self._last.get(topic), topic)

    def known(self, topic: str, field: str) -> Any:
        """Wait for a field, and return it. The first samples may be older than its first reading."""
        return until(
            lambda: [value for value in [self._last.get(topic, {}).get(field)] if value is not None], field
        )[0]

    def silent(self, topic: str) -> bool:
        return topic not in self._last

    def close(self) -> None:
        self._session.close()
