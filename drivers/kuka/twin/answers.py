"""Hand the client's answers to the controller, and name each in the words of the wire log."""

from __future__ import annotations

from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.kuka.protocol import decode_command

from .controller import Controller


class Answers:
    """The answers of one client, in order."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._last: tuple[float, ...] = ()  # positions of the answer before

    def take(self, data: bytes) -> str:
        """Hand a datagram to the controller.

        Returns:
            ``setpoint`` when its positions differ from those of the answer before, ``safe`` when
            they repeat them or when it has none, ``garbled`` when it is no command message.
        """
        try:
            command = decode_command(data)
        except MalformedFrame:
            return "garbled"
        position = command.position
        moves = bool(position) and position != self._last and not self._controller.mirrors(command)
        self._last = position or self._last
        self._controller.hear(command)
        return "setpoint" if moves else "safe"
