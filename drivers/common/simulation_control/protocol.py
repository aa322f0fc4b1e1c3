"""Frames of the simulation control: four bytes of length (little endian), then a msgpack array
tagged with its type.

A reply has the ``number`` of its request; a request with 0 gets no reply. Values are those of the model,
one per axis in the order of ``Axes``: radians or metres, for a gripper its closed fraction. The docstring
of a request names its reply.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Generic, TypeVar

import msgspec

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

HEADER = 4
MAX_REQUEST = 1 << 16
MAX_REPLY = 1 << 26
"""Longest reply in bytes: a picture."""

MOST_STEPS = 100_000
STEP_S = 30.0
"""Longest time in seconds that the steps of one request may take."""

LIMP = "limp"
HOLD = "hold"
LAND = "land"


class Frame(msgspec.Struct, frozen=True, array_like=True, tag=True):
    number: int


class Handshake(Frame, frozen=True):
    """Ask for the axes. Reply: ``Axes``."""


class Take(Frame, frozen=True):
    """Energise all joints that the wire does not hold, at their present positions. Reply: ``Sample``."""


class Aim(Frame, frozen=True):
    """Set new targets. Only the client of the last ``Take`` may do this. No reply."""

    values: tuple[float, ...]


class Safe(Frame, frozen=True):
    """Bring the taken joints to a safe state. Reply: ``Sample``.

    ``limp`` releases them. ``hold`` sets each target to the position. ``land`` does the same, but a
    flying robot lands.
    """

    safe_state: str


class Read(Frame, frozen=True):
    """Read the state. Reply: ``Sample``."""


class Reset(Frame, frozen=True):
    """Return to the first pose and hold it. Reply: ``Sample``, or ``No`` while the wire holds a joint."""


class Step(Frame, frozen=True):
    """Simulate 1 to ``MOST_STEPS`` time steps at once, after the earlier requests of other clients.
    Reply: ``Sample``, or ``No`` while the wire holds a joint."""

    steps: int


class Render(Frame, frozen=True):
    """Take a picture. Reply: ``Picture`` or ``No``."""

    width: int
    height: int
    camera: str  # "": the whole robot


class AddObject(Frame, frozen=True):
    """Add an object with the fields of ``scenery.Object``. Reply: ``Done`` or ``No``."""

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
    """Add a camera with the fields of ``scenery.Camera``. Reply: ``Done`` or ``No``."""

    name: str
    position: tuple[float, ...]
    target: tuple[float, ...]
    fov_deg: float
    body: str


class RemoveObject(Frame, frozen=True):
    """Remove an object. Reply: ``Done`` or ``No``."""

    name: str


class Save(Frame, frozen=True):
    """Save the state under this name. Reply: ``Done`` or ``No``."""

    name: str


class Load(Frame, frozen=True):
    """Return to a saved state. Reply: ``Sample`` or ``No``, also while the wire holds a joint."""

    name: str


class GetModel(Frame, frozen=True):
    """Ask for the scene as a compiled MuJoCo model. Reply: ``Model`` or ``No``."""


class GetPose(Frame, frozen=True):
    """Ask for the pose. Reply: ``Pose``."""


class Axes(Frame, frozen=True):
    axes: tuple[str, ...]


class Sample(Frame, frozen=True):
    time_s: float  # of the simulation
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]  # newton metres, or newtons
    hands: tuple[int, ...]  # holder of each joint: 0 no holder, 1 the wire, 2 the simulation


class Picture(Frame, frozen=True):
    """Rows from the top, three bytes a pixel."""

    width: int
    height: int
    rgb: bytes


class Model(Frame, frozen=True):
    binary: bytes
    scene: int = 0  # number of the scene; it changes with the bodies and cameras


class Pose(Frame, frozen=True):
    """``qpos`` of the ``Model`` with this ``scene`` number."""

    qpos: tuple[float, ...]
    scene: int = 0


class Done(Frame, frozen=True):
    """The request was carried out."""


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
    """Decodes frames from bytes in pieces of any size."""

    def __init__(self, kind: msgspec.msgpack.Decoder[FrameT], longest: int) -> None:
        self._kind = kind
        self._longest = longest
        self._held = bytearray()

    def feed(self, data: bytes) -> Iterator[FrameT]:
        """Yield the frames that are complete. Raise ``MalformedFrame``."""
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
