"""Pass the client's answers to the controller, and return the kind of each for the wire log."""

from __future__ import annotations

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.kuka.protocol import decode_command

from .controller import Controller


class Answers:
    """The answers of one client."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._last: tuple[float, ...] = ()  # positions of the previous answer

    def take(self, data: bytes) -> str:
        """Pass a datagram to the controller.

        Returns:
            ``setpoint`` if its positions differ from those of the previous answer, ``safe`` if they
            repeat them or are missing, ``garbled`` if it is no command message.
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
