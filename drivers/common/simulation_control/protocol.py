"""Encode and decode the frames of a simulation's control socket.

A frame has four bytes of length (little endian), then a msgpack array that is tagged with its type. A reply has the
``number`` of its request; a request with the number 0 gets no reply. Positions, targets and so on have one value
per axis, in the order of ``Axes``: radians or metres, for a gripper the fraction by which it is closed. The
docstring of each request names its reply.
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
    """Request the names of the axes. Reply: ``Axes``."""


class Take(Frame, frozen=True):
    """Let the simulation control all joints that no command in the robot's real protocol has energised. They hold
    their positions. Reply: ``Sample``."""


class Aim(Frame, frozen=True):
    """Set new targets of the joints that the simulation controls. Only the client that sent the last ``Take``
    (request for this control) may do this. No reply."""

    values: tuple[float, ...]


class Safe(Frame, frozen=True):
    """Bring the joints that the simulation controls to a safe state. Reply: ``Sample``.

    ``limp`` releases them. ``hold`` lets them hold their positions. ``land`` lets a flying robot land; for other
    robots it is the same as ``hold``.
    """

    safe_state: str


class Read(Frame, frozen=True):
    """Read time, positions, speeds and efforts. Reply: ``Sample``."""


class Reset(Frame, frozen=True):
    """Return the robot to its initial pose. Reply: ``Sample``, or ``No`` if a command in the robot's real protocol
    has energised a joint."""


class Step(Frame, frozen=True):
    """Simulate 1 to ``MOST_STEPS`` time steps at once, after the earlier requests of other clients. Reply:
    ``Sample``, or ``No`` if a command in the robot's real protocol has energised a joint."""

    steps: int


class Render(Frame, frozen=True):
    """Take a picture. Reply: ``Picture``, or ``No`` if it is refused."""

    width: int
    height: int
    camera: str  # name of the camera; empty for a view of the whole robot
    qpos: tuple[float, ...] = ()  # the state to draw; empty for the present one


class AddObject(Frame, frozen=True):
    """Add an object with the fields of ``scenery.Object``. Reply: ``Done``, or ``No`` if it is refused."""

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
    """Add a camera with the fields of ``scenery.Camera``. Reply: ``Done``, or ``No`` if it is refused."""

    name: str
    position: tuple[float, ...]
    target: tuple[float, ...]
    fov_deg: float
    body: str


class RemoveObject(Frame, frozen=True):
    """Remove an object that was added. Reply: ``Done``, or ``No`` if it is refused."""

    name: str


class Save(Frame, frozen=True):
    """Save the state of the simulation under this name. Reply: ``Done``, or ``No`` if it is refused."""

    name: str


class Load(Frame, frozen=True):
    """Return the simulation to a state that ``Save`` has saved. Reply: ``Sample``, or ``No`` if there is no such
    state, or if a command in the robot's real protocol has energised a joint."""

    name: str


class Pause(Frame, frozen=True):
    """Stop the time of the simulation, so that it advances only by ``Step``; or let it run again. Reply: ``Done``,
    or ``No`` if it is refused."""

    on: bool


class SetLight(Frame, frozen=True):
    """Change the light of pictures. Reply: ``Done``, or ``No`` if it is refused."""

    brightness: float  # 1 is the usual light
    azimuth_deg: float  # direction from which the main lamp shines, from above: 0 is along x, 90 along y
    elevation_deg: float  # its height above the horizon


class GetObjects(Frame, frozen=True):
    """Request the poses of the objects that were added. Reply: ``Objects``."""


class GetModel(Frame, frozen=True):
    """Request the scene as a compiled MuJoCo model. Reply: ``Model``, or ``No`` if it is refused."""


class GetPose(Frame, frozen=True):
    """Request the present pose of the scene. Reply: ``Pose``."""


class Axes(Frame, frozen=True):
    axes: tuple[str, ...]


class Sample(Frame, frozen=True):
    time_s: float  # simulated time in seconds
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]  # newton metres; newtons for a linear axis
    # Controller of each joint. 1: commands in the robot's real protocol, 2: the simulation, 0: neither of these.
    commanders: tuple[int, ...]
    # Of a base that moves freely; otherwise empty.
    base_xyz_m: tuple[float, ...] = ()
    orientation_wxyz: tuple[float, ...] = ()
    gyro_rad_s: tuple[float, ...] = ()


class Picture(Frame, frozen=True):
    """A picture: its rows from top to bottom, with three bytes (red, green, blue) per pixel."""

    width: int
    height: int
    rgb: bytes


class Model(Frame, frozen=True):
    binary: bytes
    scene: int = 0  # number of the scene, which increases when objects or cameras change


class Pose(Frame, frozen=True):
    """Reply to ``GetPose``: the state ``qpos`` (positions of all joints and free objects) of the ``Model`` that
    has the same ``scene`` number."""

    qpos: tuple[float, ...]
    scene: int = 0


class Objects(Frame, frozen=True):
    """Reply to ``GetObjects``: position (m) and orientation (w, x, y, z) of each object by its name."""

    poses: dict[str, tuple[float, ...]]


class Done(Frame, frozen=True):
    """Reply to a request that was carried out and returns no data."""


class No(Frame, frozen=True):
    reason: str


Change = AddObject | AddCamera | RemoveObject | Save | Pause | SetLight
Question = Read | Render | GetModel | GetPose | GetObjects
Request = Handshake | Take | Aim | Safe | Reset | Step | Load | Change | Question
Reply = Axes | Sample | Picture | Model | Pose | Objects | Done | No

FrameT = TypeVar("FrameT")

_encode = msgspec.msgpack.Encoder().encode


def encode(frame: Frame) -> bytes:
    body = _encode(frame)
    return len(body).to_bytes(HEADER, "little") + body


class Decoder(Generic[FrameT]):
    """Decode frames from received bytes, which may arrive in pieces of any size."""

    def __init__(self, decoder: msgspec.msgpack.Decoder[FrameT], longest: int) -> None:
        self._decoder = decoder
        self._longest = longest
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[FrameT]:
        """Yield each complete frame. Raise ``MalformedFrame``."""
        buffer = self._buffer
        buffer += data
        while len(buffer) >= HEADER:
            size = int.from_bytes(buffer[:HEADER], "little")
            if size > self._longest:
                raise MalformedFrame(f"a frame of {size} bytes, more than {self._longest}")
            if len(buffer) < HEADER + size:
                return
            body = bytes(buffer[HEADER : HEADER + size])
            del buffer[: HEADER + size]
            try:
                frame = self._decoder.decode(body)
            except (msgspec.MsgspecError, UnicodeDecodeError) as error:
                raise MalformedFrame(f"a frame that means nothing: {error}") from None
            yield frame


def request_decoder() -> Decoder[Request]:
    return Decoder(msgspec.msgpack.Decoder(Request), MAX_REQUEST)


def reply_decoder() -> Decoder[Reply]:
    return Decoder(msgspec.msgpack.Decoder(Reply), MAX_REPLY)
