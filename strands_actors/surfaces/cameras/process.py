"""The process of one camera. It opens the source, reads it, and puts the newest picture into shared memory.

The robot's root process starts the camera's process. Of the robot, the camera's process can access only the
connection to the root process, and the file of its pictures. No other process waits for a camera, so the robot
keeps running if the camera's process is killed or frozen. The root process then starts the camera's process again.

The states are in ``report.CameraReport``. When the source fails, it is opened again after a pause
(``PAUSES_S``). When a call of the source does not return in time, its thread may hang in the device's driver. So
the process ends with the exit code ``HUNG``, and the root process starts another.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Awaitable, Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import msgspec
import trio

from strands_actors.contract.cameras import CameraSettings, Picture, PictureSource
from strands_actors.contract.loading import load
from strands_actors.contract.wire import WireDown
from strands_actors.kernel.actor import Actor, describe
from strands_actors.kernel.channels.frame_ring import FrameRing, NoRing
from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.clock import NS, MonotonicClock
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import Node
from strands_actors.kernel.processes.child import report_failure
from strands_actors.kernel.processes.identity import take_name
from strands_actors.supervisors import addresses
from strands_actors.supervisors.introspection import Introspector

from . import report as reports
from .compressing import Compressor
from .report import CameraReport

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray

BEAT_S = 0.25
NICE = 5
"""Niceness of a camera's process: the robot computes first, and a picture may come late."""
DEFAULT_FPS = 30.0
OPEN_S = 15.0
READ_S = 5.0
"""Longest time for a source to give a picture (``OPEN_S``: to open). After that this process ends."""
AHEAD_S = 0.1
"""Largest time by which a picture may be stamped ahead of now. A stamp of another clock is ahead by years."""
PAUSES_S = (0.5, 1.0, 2.0, 4.0)
"""Pauses before the source is opened again: after the first failure, the second, and so on. The last one
repeats."""
SETTLED_S = 5.0
"""After a source has run for so long, the pauses begin with the first again."""
HUNG = 3
"""Exit code of a process with a source that hangs."""

Open = Callable[[CameraSettings], Awaitable[PictureSource]]


class Hangs(Exception):
    """A call of the camera's source of pictures does not return in time."""


class UnexpectedPicture(Exception):
    """The source gives pictures of another size or type than requested. The exception's text describes them."""


class Tick(Message, frozen=True):
    lane = "latest"

    now_ns: int


class Camera(Actor):
    """Read the pictures of one camera until the process ends.

    Args:
        settings: The settings of the camera.
        ring: The ring buffer in shared memory for the camera's pictures.
        open_source: Function that opens the source of the pictures, such as a device. Any exception is reported,
            and the source is opened again later.
    """

    def __init__(self, settings: CameraSettings, ring: FrameRing, open_source: Open) -> None:
        self._settings = settings
        self._ring = ring
        self._open_source = open_source
        self._report = CameraReport()
        self._rate = Rate()
        self._compressor = Compressor(ring)

    async def started(self) -> None:
        self._tell()
        self.context.every(BEAT_S, Tick)
        self.context.start_soon(self._stream)

    def receive(self, message: Tick) -> None:
        self._ring.beat(message.now_ns)

    # -- pictures

    async def _stream(self) -> None:
        failures = 0
        while True:
            began_s = trio.current_time()
            state, reason = await self._until_lost()
            self._tell(state=state, reason=reason, fps=0.0)
            failures = 0 if trio.current_time() - began_s > SETTLED_S else failures
            await trio.sleep(PAUSES_S[min(failures, len(PAUSES_S) - 1)])
            failures += 1

    async def _until_lost(self) -> tuple[str, str]:
        """Open the source and read it until it fails. Return the camera's new state (``refused`` or
        ``unavailable``) and the reason."""
        source: PictureSource | None = None
        try:
            with _within(OPEN_S, "to open"):
                source = await self._open_source(self._settings)
            self._tell(state="starting", reason="", opened=self._report.opened + 1)
            await self._read(source)
        except Hangs as failure:
            # A thread may hang in the device's driver. Only ending the process ends such a thread.
            self._tell(state="unavailable", reason=str(failure), fps=0.0)
            os._exit(HUNG)
        except UnexpectedPicture as failure:
            return "refused", str(failure)
        except (WireDown, OSError) as failure:
            return "unavailable", str(failure)
        except Exception as failure:  # The code of a source may raise anything.
            return "unavailable", describe(failure)
        finally:
            if source is not None:
                with trio.CancelScope(shield=True), trio.move_on_after(1.0):
                    await source.aclose()
        return "unavailable", "the camera has ended"

    async def _read(self, source: PictureSource) -> None:
        settings = self._settings
        period_s = 1.0 / (settings.fps or DEFAULT_FPS)
        warm_s = trio.current_time() + settings.warmup_s
        next_s = trio.current_time()
        last_ns = 0
        while True:
            if not source.paced:
                next_s = max(next_s + period_s, trio.current_time())
                await trio.sleep_until(next_s)
            with _within(READ_S, "to give a picture"):
                picture = await source.read()
            if trio.current_time() < warm_s:
                continue
            if picture.captured_ns <= last_ns:
                raise WireDown("the camera gives the same picture again")
            ahead_s = (picture.captured_ns - self.context.clock.now_ns()) / 1e9
            if ahead_s > AHEAD_S:  # A time stamp in the future would keep the picture from becoming stale.
                raise WireDown(f"captured_ns is {ahead_s:g} s in the future. Use Python's time.monotonic_ns")
            last_ns = picture.captured_ns
            self._put(picture)
            await trio.lowlevel.checkpoint()

    def _put(self, picture: Picture) -> None:
        image = upright(picture.image, self._settings)
        height, width, _ = image.shape
        number = self._ring.put(picture.captured_ns, height, width, image.data.cast("B"))
        if self._compressor.wants(self.context.clock.now_ns()):
            self.context.start_soon(self._compressor.compress, image, picture.captured_ns, number)
        if self._compressor.problem != self._report.compressed:
            self._tell(compressed=self._compressor.problem)
        if fps := self._rate.count(picture.captured_ns):
            self._tell(state="streaming", reason="", fps=fps, width=width, height=height)
        elif self._report.state != "streaming":
            self._tell(state="streaming", reason="", width=width, height=height)

    def _tell(self, **changes: Any) -> None:
        self._report = msgspec.structs.replace(self._report, **changes)
        self._ring.write_description(reports.encode(self._report))


class Rate:
    """Measure the rate of pictures once a second."""

    def __init__(self) -> None:
        self._began_ns = 0
        self._count = 0

    def count(self, now_ns: int) -> float:
        """Count a picture. Return pictures per second at the end of each second, and 0 otherwise."""
        took_ns = now_ns - self._began_ns
        if not 0 <= took_ns < 10 * NS:  # This is the first picture, or the first one after a pause.
            self._began_ns, self._count = now_ns, 0
            return 0.0
        self._count += 1
        if took_ns < NS:
            return 0.0
        fps = self._count * NS / took_ns
        self._began_ns, self._count = now_ns, 0
        return round(fps, 1)


def upright(image: NDArray[numpy.uint8], settings: CameraSettings) -> NDArray[numpy.uint8]:
    """Return an image rotated by the settings. Raise ``UnexpectedPicture`` if its size or type is not the requested
    one."""
    import numpy

    if image.dtype != numpy.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise UnexpectedPicture(f"it gives {image.dtype} of shape {image.shape}, not bytes in three colours")
    if settings.rotation:
        image = numpy.rot90(image, -settings.rotation // 90)
    height, width, _ = image.shape
    if settings.width is not None and (width, height) != (settings.width, settings.height):
        raise UnexpectedPicture(
            f"it gives {width} x {height}, and {settings.width} x {settings.height} is asked for. "
            "Give width and height of a size that it has"
        )
    return numpy.ascontiguousarray(image)


@contextlib.contextmanager
def _within(seconds: float, purpose: str) -> Iterator[None]:
    with trio.move_on_after(seconds) as scope:
        yield
    if scope.cancelled_caught:
        raise Hangs(f"it took more than {seconds:g} s {purpose}")


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Run a camera's process."""
    take_name(args["robot"], f"camera {args['settings']['name']}", args["label"])
    os.nice(NICE)
    trio.run(_main, args, sock)


async def _main(args: dict[str, Any], sock: socket.socket) -> None:
    robot: str = args["robot"]
    settings = msgspec.convert(args["settings"], CameraSettings)
    actors = addresses.of(robot)
    node = Node(f"{robot}.camera.{settings.name}.{os.getpid()}", MonotonicClock())
    try:
        ring = FrameRing(args["ring"], writes=True)
    except NoRing as failure:
        raise SystemExit(f"camera {settings.name}: {failure}") from None
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        link = Link(node, sock, on_closed=lambda: os._exit(0))  # This process ends when the root process ends.
        await nursery.start(link.run)
        process = f"camera/{settings.name}"
        nursery.start_soon(node.cell(actors.introspection(process), Introspector, "introspection").run)
        cell = node.cell(actors.path(process), lambda: Camera(settings, ring, partial(_open, args["source"])))
        try:
            await cell.run()
        except Exception as failure:
            report_failure(f"camera {settings.name}", failure)
            os._exit(1)  # The root starts another process.


async def _open(function: str, settings: CameraSettings) -> PictureSource:
    """Import and call the function that opens a source. The function may be a user's code. It is imported here,
    so that a failure of the import is reported."""
    source: PictureSource = await load(function)(settings)
    return source
