"""Walk of the parts of a client's answer to a KUKA controller (FRI).

The interface has no error answer: the controller ignores what it does not use. So each question builds two twins
that are commanding. One gets a plain answer, and the other one the same answer with the part. Whether the part
counts is seen in their states after a cycle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.kuka import protocol as p
from strands_actors.drivers.kuka.io import Io, IoDirection, IoType, encode_ios
from strands_actors.drivers.kuka.robots import arm_of
from strands_actors.drivers.kuka.session import FriSession
from strands_actors.drivers.kuka.twin.answers import FIELDS, Answers
from strands_actors.drivers.kuka.twin.controller import Controller

from .walk import Answer, Walk, fingerprint

ARM = arm_of("kuka_iiwa")
SAMPLE_S = 0.005
LAMP = Io("Panel.Lamp", IoType.BOOLEAN, IoDirection.OUTPUT, 0)
FAR_RAD = 2e-3
"""A little less than a joint may move in a cycle."""


class Anew:
    """Stands for the two twins that each question builds anew: no question changes it."""


class Session:
    """A twin that is commanding, and the parts of the client's next answer."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.controller = Controller(ARM, sample_ms=5, now_s=lambda: self.now_s, ios=(LAMP,))
        client = FriSession(ARM.speed_rad_s)
        self.message = self.controller.cycle()
        for _ in range(160):
            assert client.accept(self.message)
            self.controller.take_answer(client.answer(self.message))
            self.now_s += SAMPLE_S
            self.message = self.controller.cycle()
        assert self.controller.state is p.State.COMMANDING_ACTIVE
        self.answers = Answers(self.controller)

    def answer(self, header: bytes, content: bytes, rest: bytes = b"") -> None:
        """Send an answer, and run the cycle after it."""
        body = pb.bytes_field(1, header) + pb.bytes_field(2, content) + rest
        self.answers.take(body + pb.bytes_field(15, pb.varint_field(1, len(body))))
        self.now_s += SAMPLE_S
        self.controller.cycle()

    def header(self, answered: int | None = None) -> bytes:
        """Return a header that names the message that is answered. None: the last one."""
        sequence = self.message.sequence if answered is None else answered
        return pb.varint_field(1, p.COMMAND_ID) + pb.varint_field(2, 1000) + pb.varint_field(3, sequence)

    def positions(self, far_rad: float = 0.0) -> bytes:
        goal = [rad + far_rad for rad in self.controller.commanded]
        return pb.bytes_field(1, pb.double_fields(1, goal))

    def state(self) -> object:
        """Return what the controller is and does, without the numbers of messages."""
        robot = self.controller
        return fingerprint((robot.state, robot.motion, robot.ios, robot.commanded, robot.plant, robot._missed))


def doubles(number: int, *values: float) -> bytes:
    return pb.bytes_field(number, pb.double_fields(1, values))


PARTS: dict[str, tuple[Callable[[Session], None], Callable[[Session], None]]] = {
    # Each part: an answer with it, and the same answer without it.
    "header": (
        lambda session: session.answer(session.header(), session.positions()),
        lambda session: session.answer(session.header(session.message.sequence - 5), session.positions()),
    ),
    "joint positions": (
        lambda session: session.answer(session.header(), session.positions(FAR_RAD)),
        lambda session: session.answer(session.header(), session.positions()),
    ),
    "outputs": (
        lambda session: session.answer(
            session.header(), session.positions() + encode_ios(5, (Io(LAMP.name, LAMP.type, LAMP.direction, 1),))
        ),
        lambda session: session.answer(session.header(), session.positions()),
    ),
}
OTHERS = {
    # Fields of the vendor's message that are for other modes of the robot program, and fields that nobody has.
    "wrench": doubles(2, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    "joint torques": doubles(3, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    "transformations": pb.bytes_field(4, pb.bytes_field(1, b"Base.Track") + doubles(2, *[1.0] * 12)),
    "an input": encode_ios(5, (Io("Panel.Button", IoType.BOOLEAN, IoDirection.INPUT, 1),)),
    "an output of another type": encode_ios(5, (Io(LAMP.name, IoType.ANALOG, IoDirection.OUTPUT, 1.0),)),
    "an output that is not registered": encode_ios(5, (Io("Panel.Other", IoType.BOOLEAN, IoDirection.OUTPUT, 1),)),
    **{f"field {number}": doubles(number, 1.0) for number in (6, 7, 8, 9, 10)},
}


def ask_part(anew: Anew, part: str, data: bytes) -> Answer:
    one, other = Session(), Session()
    if part in PARTS:
        with_part, without = PARTS[part]
        with_part(one)
        without(other)
    else:
        one.answer(one.header(), one.positions() + OTHERS[part])
        other.answer(other.header(), other.positions())
    counts = one.state() != other.state()
    return Answer(counts, "an effect" if counts else "")


def walks() -> Iterator[Walk]:
    """Yield the walk of this module."""
    yield Walk(
        "fri",
        FIELDS,
        (*PARTS, *OTHERS),
        Anew,
        ask_part,
        dict.fromkeys(FIELDS.effects, b""),
        (b"",),
    )
