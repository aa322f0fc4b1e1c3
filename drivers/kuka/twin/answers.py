"""Pass the client's answers to the simulated controller, and classify each answer for the log."""

from __future__ import annotations

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.kuka.protocol import decode_command

from .controller import Controller

FIELDS: Modelled[str] = Modelled(
    "parts of the client's answer",
    {
        "header": "names the message that it answers; a late answer counts as missed",
        "joint positions": "moves the arm in the client mode POSITION; beyond the speed limit the session ends",
        "outputs": "sets registered outputs; another request for an output is noted in the log and has no effect",
    },
    "ignored: the interface has no error answer. An answer without joint positions aborts the motion",
)


class Answers:
    """Receive the answers of one client, and remember the last positions."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._last: tuple[float, ...] = ()  # Joint positions in the previous answer.

    def take(self, data: bytes) -> str:
        """Decode a datagram of the client and pass it to the controller.

        Returns:
            ``setpoint`` if its positions differ from those of the previous answer. ``safe`` if it repeats the
            previous positions or has no positions. ``garbled`` if it is not a command message.
        """
        try:
            command = decode_command(data)
        except MalformedFrame:
            return "garbled"
        position = command.position
        moves = bool(position) and position != self._last and not self._controller.mirrors(command)
        self._last = position or self._last
        self._controller.take_answer(command)
        return "setpoint" if moves else "safe"
