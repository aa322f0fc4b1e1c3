"""A subscriber written for strands-robots: its keys, its field names, nothing of ours but the note
that says where the robot is."""

from __future__ import annotations

import json
from typing import Any

import zenoh

from strands_actors.caller.processes.run_directory import notes
from tests.answers import until


class Subscriber:
    """As one of theirs: a plain zenoh session, the last JSON record of each topic."""

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
        """A field once it is there: the first samples may be of before it was read."""
        return until(
            lambda: [value for value in [self._last.get(topic, {}).get(field)] if value is not None], field
        )[0]

    def silent(self, topic: str) -> bool:
        return topic not in self._last

    def close(self) -> None:
        self._session.close()
