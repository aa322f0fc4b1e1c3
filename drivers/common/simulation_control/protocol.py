"""Frames of the simulation control: four bytes of length (little endian), then a msgpack array
tagged with its type.

A request's ``number`` comes back in its reply; 0 wants none. Values are those of the model: radians
or metres, a gripper's closed fraction; one per axis, in the order of ``Axes``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Generic, TypeVar

import msgspec

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

HEADER = 4
MAX_REQUEST = 1 << 16
MAX_REPLY = 1 << 26
"""Bytes; the longest is a picture."""

MOST_STEPS = 100_000
STEP_S = 30.0
"""Longest time that they may take."""

LIMP = "limp"
HOLD = "hold"
LAND = "land"


class Frame(msgspec.Struct, frozen=True, array_like=True, tag=True):
    number: int


class Handshake(Frame, frozen=True):
    """Who is there? ``Axes``."""


class Take(Frame, frozen=True):
    """Energise, where the joints are, all that the wire does not hold. ``Sample``."""


class Aim(Frame, frozen=True):
    """New targets, from the client that took it. No reply."""

    values: tuple[float, ...]


class Safe(Frame, frozen=True):
    """``limp``: let go of what is taken. ``hold``: target := position. ``land``: as ``hold``, but
    what flies comes down. ``Sample``."""

    safe_state: str


class Read(Frame, frozen=True):
    """``Sample``."""


class Reset(Frame, frozen=True):
    """Back to where it began, held there. ``Sample``, or ``No`` while the wire holds a joint."""


class Step(Frame, frozen=True):
    """Let so many time steps pass at once, 1 to ``MOST_STEPS``, after what other clients have said
    before. ``Sample``, or ``No`` while the wire holds a joint."""

    steps: int


class Render(Frame, frozen=True):
    """``Picture``, or ``No``."""

    width: int
    height: int
    camera: str  # "": the whole robot


class AddObject(Frame, frozen=True):
    """``Done``, or ``No``. The fields are those of ``scenery.Object``."""

    name: str
    shape: str
    position: tuple[float, ...]
    orientation: tuple[float, ...]
    size: tuple[float, ...]
    color: tuple[float, ...]
    mass_kg: float
    fixed: bool
    mesh: str


class AddCamera(Frame, frozen=True):
    """``Done``, or ``No``. The fields are those of ``scenery.Camera``."""

    name: str
    position: tuple[float, ...]
    target: tuple[float, ...]
    fov_deg: float
    body: str


class RemoveObject(Frame, frozen=True):
    """``Done``, or ``No``."""

    name: str


class Save(Frame, frozen=True):
    """Keep the state under this name. ``Done``, or ``No``."""

    name: str


class Load(Frame, frozen=True):
    """Go back to a saved state. ``Sample``, or ``No``, also while the wire holds a joint."""

    name: str


class GetModel(Frame, frozen=True):
    """The scene as a compiled MuJoCo model. ``Model``, or ``No``."""


class GetPose(Frame, frozen=True):
    """``Pose``."""


class Axes(Frame, frozen=True):
    axes: tuple[str, ...]


class Sample(Frame, frozen=True):
    time_s: float  # of the simulation
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]  # newton metres, or newtons
    hands: tuple[int, ...]  # who holds each: 0 nobody, 1 the wire, 2 the simulation


class Picture(Frame, frozen=True):
    """Rows from the top, three bytes a pixel."""

    width: int
    height: int
    rgb: bytes


class Model(Frame, frozen=True):
    binary: bytes
    scene: int = 0  # its number: another one has other bodies or cameras


class Pose(Frame, frozen=True):
    """``qpos`` of the ``Model`` with that number."""

    qpos: tuple[float, ...]
    scene: int = 0


class Done(Frame, frozen=True):
    """It is done."""


class No(Frame, frozen=True):
    why: str


Change = AddObject | AddCamera | RemoveObject | Save
Request = Handshake | Take | Aim | Safe | Read | Reset | Step | Render | Load | Change | GetModel | GetPose
Reply = Axes | Sample | Picture | Model | Pose | Done | No

FrameT = TypeVar("FrameT")

_encode = msgspec.msgpack.Encoder().encode


def encode(frame: Frame) -> bytes:
    body = _encode(frame)
    return len(body).to_bytes(HEADER, "little") + body


class Decoder(Generic[FrameT]):
    """Bytes in any pieces, frames out."""

    def __init__(self, kind: msgspec.msgpack.Decoder[FrameT], longest: int) -> None:
        self._kind = kind
        self._longest = longest
        self._held = bytearray()

    def feed(self, data: bytes) -> Iterator[FrameT]:
        """Raise ``MalformedFrame``."""
        held = self._held
        held += data
        while len(held) >= HEADER:
            size = int.from_bytes(held[:HEADER], "little")
            if size > self._longest:
                raise MalformedFrame(f"a frame of {size} bytes, more than {self._longest}")
            if len(held) < HEADER + size:
                return
            body = bytes(held[HEADER : HEADER + size])
            del held[: HEADER + size]
            try:
                frame = self._kind.decode(body)
            except (msgspec.MsgspecError, UnicodeDecodeError) as error:
                raise MalformedFrame(f"a frame that means nothing: {error}") from None
            yield frame


def request_decoder() -> Decoder[Request]:
    return Decoder(msgspec.msgpack.Decoder(Request), MAX_REQUEST)


def reply_decoder() -> Decoder[Reply]:
    return Decoder(msgspec.msgpack.Decoder(Reply), MAX_REPLY)
