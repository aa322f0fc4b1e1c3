"""Keep the process of each camera running. If one ends or freezes, it is started again after a pause.

The robot never waits for a camera, and never ends with one. The state of a camera shows when its process does not
run. Pictures do not pass through the root. They are in a file in memory (``frame_ring``), of which the root reads
one page.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
import trio

from strands_actors.kernel.actor import describe
from strands_actors.kernel.channels.frame_ring import FrameRing, NoRing
from strands_actors.kernel.clock import NS
from strands_actors.kernel.node import Node
from strands_actors.kernel.processes.child import report_failure
from strands_actors.kernel.processes.process import ChildProcess
from strands_actors.supervisors import permissions as channels

LOOK_S = 0.5
LINK_LOOK_S = 0.02
FIRST_S = 5.0
"""Cameras start after this many seconds, even if the robot is not connected yet."""
SILENT_S = 5.0
"""A camera process is killed after this many seconds without a heartbeat, because it is frozen. It has the lowest
priority of all processes, so a second of silence is usual on a busy machine."""
PAUSES_S = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Pauses before the restarts. The last one is repeated."""
DOWN = "down"
"""The state of a camera without a process."""
SETTLED_S = 10.0
"""After a process has run for this many seconds, the next pause is the first one again."""

Start = Callable[[str, Mapping[str, Any]], Awaitable[ChildProcess]]


class Kept(NamedTuple):
    """One camera as configured by the caller. ``entry`` is the function that its process runs, with ``args``."""

    name: str
    ring: str
    entry: str
    args: dict[str, Any]


class CameraKeeper:
    """Keep the processes of all cameras of one robot running.

    Attributes:
        starts: Number of starts of each camera's process.
        processes: The running process of each camera.
    """

    def __init__(
        self,
        node: Node,
        robot: str,
        cameras: Sequence[Mapping[str, Any]],
        start: Start,
        linked: Callable[[], bool],
    ) -> None:
        """Prepare the cameras.

        Args:
            node: The root's node.
            robot: The robot's name.
            cameras: The fields of ``Kept`` for each camera.
            start: Starts a process.
            linked: Returns True if the robot is connected. Cameras start only then, so that they do not slow the
                connection down.
        """
        self._linked = linked
        self._node = node
        self._robot = robot
        self._cameras = [Kept(**camera) for camera in cameras]
        self._start = start
        self._rings: dict[str, FrameRing] = {}
        self.processes: dict[str, ChildProcess] = {}
        self.starts: dict[str, int] = {camera.name: 0 for camera in self._cameras}
        self._ended = False

    @property
    def rings(self) -> Mapping[str, FrameRing]:
        """Return the shared ring buffers of pictures that could be opened, by camera."""
        return self._rings

    async def run(self) -> None:
        """Keep the processes running until cancelled. Never raises, since a failing camera must not end the robot's
        processes."""
        for camera in self._cameras:
            try:
                self._rings[camera.name] = FrameRing(camera.ring, writes=True, front=True)
            except (NoRing, OSError) as failure:
                report_failure(f"camera {camera.name}", failure)
        with trio.move_on_after(FIRST_S if self._rings else 0.0):
            while not self._linked():  # noqa: ASYNC110  # there is no event to wait for
                await trio.sleep(LINK_LOOK_S)
        async with trio.open_nursery() as nursery:
            for camera in self._cameras:
                if camera.name in self._rings:
                    nursery.start_soon(self._keep, camera, self._rings[camera.name])

    def end(self) -> None:
        """Kill all camera processes, and remove their files."""
        self._ended = True
        for process in self.processes.values():
            process.kill()
        for camera in self._cameras:
            with contextlib.suppress(OSError):
                os.unlink(camera.ring)

    async def _keep(self, camera: Kept, ring: FrameRing) -> None:
        failures = 0
        while not self._ended:
            began_s = trio.current_time()
            reason = await self._until_ended(camera, ring)
            failures = 0 if trio.current_time() - began_s > SETTLED_S else failures
            pause_s = PAUSES_S[min(failures, len(PAUSES_S) - 1)]
            _tell(ring, f"{reason}. Its process is started again in {pause_s:g} s")
            await trio.sleep(pause_s)
            failures += 1

    async def _until_ended(self, camera: Kept, ring: FrameRing) -> str:
        """Start the process of a camera, wait until it has ended, and return the reason."""
        try:
            process = await self._start(camera.entry, camera.args)
        except OSError as error:
            return f"no process can be started: {error}"
        self.processes[camera.name] = process
        self.starts[camera.name] += 1
        ring.beat(self._node.clock.now_ns())
        reason, silent = "", trio.Event()
        try:
            if self._ended:
                process.kill()
            async with trio.open_nursery() as nursery:
                channel = channels.of_camera(self._robot, camera.name)
                nursery.start_soon(process.link(self._node, channel).run)
                nursery.start_soon(self._watch, process, ring, silent)
                code = await process.wait()
                nursery.cancel_scope.cancel()
            reason = f"its process was silent for {SILENT_S:g} s and was ended" if silent.is_set() else _how(code)
        # If the link to a camera fails, for example because of an invalid message, the root must not end.
        except Exception as failure:
            report_failure(f"the link to camera {camera.name}", failure)
            reason = f"its link failed: {describe(failure)}"
            await process.fence()
        finally:
            del self.processes[camera.name]
        return reason

    async def _watch(self, process: ChildProcess, ring: FrameRing, silent: trio.Event) -> None:
        """Kill the process of a camera if it sends no heartbeat. The next process is started only after that, since
        only one process may write pictures into the ring."""
        while self._node.clock.now_ns() - ring.beaten_ns <= SILENT_S * NS:  # noqa: ASYNC110  # there is no event to wait for
            await trio.sleep(LOOK_S)
        silent.set()
        process.kill()


def _how(code: int) -> str:
    if code == -signal.SIGKILL:
        return "its process was killed"
    return f"its process ended with {f'signal {-code}' if code < 0 else f'code {code}'}"


def _tell(ring: FrameRing, reason: str) -> None:
    """Write the state of a camera without a running process into its ring buffer of pictures. The text also has
    the last problem that the process itself reported."""
    try:
        last = msgspec.msgpack.decode(ring.description)
        before = "" if last["state"] == DOWN else last["why"]
    except (msgspec.MsgspecError, TypeError, KeyError):
        before = ""
    ring.write_description(
        msgspec.msgpack.encode({"state": DOWN, "why": f"{before}. {reason}" if before else reason})
    )
