"""What a Feetech bus was told, read off the twin's log."""

from __future__ import annotations

from collections.abc import Iterator

from strands_actors.drivers.feetech import protocol
from strands_actors.testing import WireLog


def goals(log: WireLog, motor: int, since_ns: int = 0) -> Iterator[int]:
    """Return each goal of a servo, in counts, in the order of the wire."""
    goal = protocol.GOAL_POSITION
    for frame in log.host("setpoint", since_ns):
        for packet in protocol.Decoder().feed(frame.data):
            if packet.code == protocol.SYNC_WRITE:
                address, rows = protocol.rows_of(packet)
            else:
                address, rows = packet.params[0], {packet.id: packet.params[1:]}
            if motor in rows and address <= goal.address < address + len(rows[motor]):
                yield goal.decode(rows[motor], address)
