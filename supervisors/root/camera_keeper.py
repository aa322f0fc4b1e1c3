"""The root keeps a process for each camera: starts it, sees it end or freeze, starts it again, later.

Nothing of the robot waits for a camera, and a camera that cannot be kept is told, not the robot's
end. Pictures do not pass through here: they lie in a file in memory (``frame_ring``), of which the
root reads one page.
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
"""After which cameras start beside a robot that is not there yet."""
SILENT_S = 5.0
"""A process that has not beaten for so long is ended: it is frozen, or was. It computes after
everything else, so that on a busy machine a second is nothing."""
PAUSES_S = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Before it is started again, the first time, the second, ...; the last one from then on."""
DOWN = "down"
"""What is told of a camera without a process."""
SETTLED_S = 10.0
"""One that ran for so long begins anew with the first pause."""

Start = Callable[[str, Mapping[str, Any]], Awaitable[ChildProcess]]


class Kept(NamedTuple):
    """One camera, as the caller wants it. ``args``: of its process's ``entry``."""

    name: str
    ring: str
    entry: str
    args: dict[str, Any]


class CameraKeeper:
    """``starts`` and ``processes``: by camera, for who describes the tree."""

    def __init__(
        self,
        node: Node,
        robot: str,
        cameras: Sequence[Mapping[str, Any]],
        start: Start,
        linked: Callable[[], bool],
    ) -> None:
        """``linked``: whether the robot is there, whose start cameras are not to slow down."""
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
        """By camera: those that could be opened."""
        return self._rings

    async def run(self) -> None:
        """Until cancelled. Raise nothing: a robot does not end with its cameras."""
        for camera in self._cameras:
            try:
                self._rings[camera.name] = FrameRing(camera.ring, writes=True, front=True)
            except (NoRing, OSError) as failure:
                report_failure(f"camera {camera.name}", failure)
        with trio.move_on_after(FIRST_S if self._rings else 0.0):
            while not self._linked():  # noqa: ASYNC110  # nothing tells
                await trio.sleep(LINK_LOOK_S)
        async with trio.open_nursery() as nursery:
            for camera in self._cameras:
                if camera.name in self._rings:
                    nursery.start_soon(self._keep, camera, self._rings[camera.name])

    def end(self) -> None:
        """Kill every one, and remove what they have left."""
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
        """One life of its process. Why it is over."""
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
        except Exception as failure:  # of the link: what a camera says is not to end its root
            report_failure(f"the link to camera {camera.name}", failure)
            why = f"its link failed: {describe(failure)}"
            await process.fence()
        finally:
            del self.processes[camera.name]
        return why

    async def _watch(self, process: ChildProcess, ring: FrameRing, silent: trio.Event) -> None:
        """End it when it is silent. Its successor may only write once it cannot any more."""
        while self._node.clock.now_ns() - ring.beaten_ns <= SILENT_S * NS:  # noqa: ASYNC110  # nothing tells
            await trio.sleep(LOOK_S)
        silent.set()
        process.kill()


def _how(code: int) -> str:
    if code == -signal.SIGKILL:
        return "its process was killed"
    return f"its process ended with {f'signal {-code}' if code < 0 else f'code {code}'}"


def _tell(ring: FrameRing, why: str) -> None:
    """In the place of a process that has ended, whose last word goes along."""
    try:
        told = msgspec.msgpack.decode(ring.told)
        before = "" if told["state"] == DOWN else told["why"]
    except (msgspec.MsgspecError, TypeError, KeyError):
        before = ""
    ring.tell(msgspec.msgpack.encode({"state": DOWN, "why": f"{before}. {why}" if before else why}))
