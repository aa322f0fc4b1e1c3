"""Keep a process for each camera: start it, notice when it ends or freezes, and start it again later.

The robot never waits for a camera, and never ends with one. A camera that does not run is reported. Pictures do
not pass through the root. They lie in a file in memory (``frame_ring``), of which the root reads one page.
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
"""Seconds after which cameras start, even if the robot is not connected yet."""
SILENT_S = 5.0
"""Seconds without a heartbeat after which a camera process is ended, because it is or was frozen. It runs after
all other processes, so a second of silence is usual on a busy machine."""
PAUSES_S = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Pauses before the restarts. The last one is repeated."""
DOWN = "down"
"""The state of a camera without a process."""
SETTLED_S = 10.0
"""Seconds of running after which the pauses begin again with the first."""

Start = Callable[[str, Mapping[str, Any]], Awaitable[ChildProcess]]


class Kept(NamedTuple):
    """One camera as configured by the caller. ``args`` are those of its process's ``entry``."""

    name: str
    ring: str
    entry: str
    args: dict[str, Any]


class CameraKeeper:
    """Keeps the processes of all cameras of one robot.

    Attributes:
        starts: The number of starts of each camera, for descriptions of the tree.
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
            linked: Returns True if the robot is connected. Cameras wait for that, so that they do not slow it
                down.
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
        """The rings that could be opened, by camera."""
        return self._rings

    async def run(self) -> None:
        """Keep the processes until cancelled. This never raises, since a robot must not end with its cameras."""
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
            why = await self._until_ended(camera, ring)
            failures = 0 if trio.current_time() - began_s > SETTLED_S else failures
            pause_s = PAUSES_S[min(failures, len(PAUSES_S) - 1)]
            _tell(ring, f"{why}. it is started again in {pause_s:g} s")
            await trio.sleep(pause_s)
            failures += 1

    async def _until_ended(self, camera: Kept, ring: FrameRing) -> str:
        """Start the process of a camera, wait for its end, and return the reason."""
        try:
            process = await self._start(camera.entry, camera.args)
        except OSError as error:
            return f"no process can be started: {error}"
        self.processes[camera.name] = process
        self.starts[camera.name] += 1
        ring.beat(self._node.clock.now_ns())
        why, silent = "", trio.Event()
        try:
            if self._ended:
                process.kill()
            async with trio.open_nursery() as nursery:
                channel = channels.of_camera(self._robot, camera.name)
                nursery.start_soon(process.link(self._node, channel).run)
                nursery.start_soon(self._watch, process, ring, silent)
                code = await process.wait()
                nursery.cancel_scope.cancel()
            why = f"its process was silent for {SILENT_S:g} s and was ended" if silent.is_set() else _how(code)
        # A failure of the link: the messages of a camera must not end the root.
        except Exception as failure:
            report_failure(f"the link to camera {camera.name}", failure)
            why = f"its link failed: {describe(failure)}"
            await process.fence()
        finally:
            del self.processes[camera.name]
        return why

    async def _watch(self, process: ChildProcess, ring: FrameRing, silent: trio.Event) -> None:
        """Kill a silent process. Its successor may only write after its end."""
        while self._node.clock.now_ns() - ring.beaten_ns <= SILENT_S * NS:  # noqa: ASYNC110  # there is no event to wait for
            await trio.sleep(LOOK_S)
        silent.set()
        process.kill()


def _how(code: int) -> str:
    if code == -signal.SIGKILL:
        return "its process was killed"
    return f"its process ended with {f'signal {-code}' if code < 0 else f'code {code}'}"


def _tell(ring: FrameRing, why: str) -> None:
    """Write the state of a camera without a process, with the last reason that the process wrote itself."""
    try:
        last = msgspec.msgpack.decode(ring.told)
        before = "" if last["state"] == DOWN else last["why"]
    except (msgspec.MsgspecError, TypeError, KeyError):
        before = ""
    ring.tell(msgspec.msgpack.encode({"state": DOWN, "why": f"{before}. {why}" if before else why}))
