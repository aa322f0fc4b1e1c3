"""Keep a standby process running, with its own stop channel, and report its absence. The standby is the
third process, which stops the robot when root and wire have ended.

Without a standby the gate arms nothing (it refuses with ``no_standby``). A robot that already moves continues while
the standby is replaced, since root and wire both run. If it were stopped, the failure of a third process would be
enough to stop a robot, and a robot with legs would fall.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import trio

from strands_actors.contract.driver import Timing
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health.failure_detector import FailureDetector
from strands_actors.kernel.health.heartbeat import Heartbeat
from strands_actors.kernel.health.processor import suspected
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Node, Ref, Unreachable
from strands_actors.kernel.processes.child import report_failure
from strands_actors.kernel.processes.fork import ForkedAhead
from strands_actors.kernel.processes.process import ChildProcess
from strands_actors.kernel.processes.reserve import how_ended
from strands_actors.kernel.processes.spawner import Spawner
from strands_actors.supervisors import addresses
from strands_actors.supervisors import permissions as channels
from strands_actors.supervisors.page import SafetyPage
from strands_actors.supervisors.standby.messages import Guard, Guarding, LetGo, LetGone, WatchOver
from strands_actors.supervisors.standby.process import Standby
from strands_actors.supervisors.standby.watch import silent_s

from . import refusals
from .stopped_detector import LOOK_EVERY

ENTRY = "strands_actors.supervisors.standby.process:main"
START_S = 5.0
"""Longest time (s) from the start of a standby to its first heartbeat, on a busy machine."""
SILENT_S = 0.3
"""Seconds without a heartbeat after which a standby counts as frozen. Nothing that moves depends on it."""
LET_GO_S = 0.3
"""Time (s) for a standby to close its stop channel before the next wire opens the port. Then it is killed."""
MARGIN_S = 0.3
"""The rest of ``Timing.handover_s`` (s) when a standby that does not answer is given up."""
AGAIN_S = (0.0, 0.1, 0.5, 1.0)
"""Pauses before the restarts of a standby that ends at once. The last one is repeated."""
LONG_S = 5.0
"""A standby that ran for so long (s) did not end at once."""
ASK_AGAIN_S = 0.005


class StandbyKeeper:
    """Keep the standby of one robot running.

    Attributes:
        process: The running standby, or None.
        starts: Number of starts.
        on_lost: Called with the reason when the standby has ended.
        on_begun: Called when a new standby runs and needs a stop channel.
    """

    def __init__(
        self,
        node: Node,
        robot: str,
        args: dict[str, Any],
        page: int,
        safety_page: SafetyPage,
        heartbeat: Heartbeat,
        timing: Timing,
        ahead: ForkedAhead,
        spawner: Spawner,
    ) -> None:
        self._node = node
        self._robot = robot
        self._args = args
        self._page = page
        self._safety_page = safety_page
        self._heartbeat = heartbeat
        self._timing = timing
        self._ahead: ForkedAhead | None = ahead
        self._spawner = spawner
        self._ref: Ref = node.ref(addresses.of(robot).standby, Standby)
        self._wire: ChildProcess | None = None
        self._own_pidfd = os.pidfd_open(os.getpid()) if hasattr(os, "pidfd_open") else None
        self._watching = False
        # Notices that the running standby sends no heartbeats; None without a running standby.
        self._detector: FailureDetector | None = None
        self._began_ns = 0
        self.process: ChildProcess | None = None
        self.starts = 0
        self._leaving = False
        self.on_lost: Callable[[str], None] = lambda _: None
        self.on_begun: Callable[[], None] = lambda: None

    async def keep(self) -> None:
        """Keep a standby running until ``end``."""
        failures = 0
        while not self._leaving:
            began_s = trio.current_time()
            try:
                process = await self._start()
            except OSError as error:
                reason = f"no standby can be started: {error}"
            else:
                reason = await self._attend(process)
            failures = 1 if trio.current_time() > began_s + LONG_S else failures + 1
            self.on_lost(reason)
            await trio.sleep(AGAIN_S[min(failures - 1, len(AGAIN_S) - 1)])

    async def _start(self) -> ChildProcess:
        ahead, self._ahead = self._ahead, None
        # The standby gets this list when it is started, because the root may end before it can send a message.
        with self._watch_message() as first:
            args = {**self._args, "root": first.root, "wire": first.wire}
            process = None if ahead is None else ahead.start(ENTRY, args, first.descriptors)
            if process is None:
                process = await self._spawner.start(ENTRY, args, session=True, descriptors=first.descriptors)
        self.starts += 1
        self.process = process
        return process

    async def _attend(self, process: ChildProcess) -> str:
        """Wait until the standby has ended, and return the reason."""
        self._heartbeat.forget()
        timing = self._timing
        self._began_ns = self._node.clock.now_ns()
        self._detector = FailureDetector(
            max(SILENT_S, silent_s(timing)), LOOK_EVERY * timing.tick_s, partial(suspected, process.pid)
        )
        self._watching = False
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._carry, process)
            nursery.start_soon(self._begin)
            code = await process.wait()
            nursery.cancel_scope.cancel()
        self.process = self._detector = None
        return f"the standby process ended with {how_ended(code)}"

    async def _carry(self, process: ChildProcess) -> None:
        try:
            await process.link(self._node, channels.of_standby(self._robot)).run()
        except Exception as error:
            report_failure("the link to the standby process", error)
        process.kill()  # a standby without a link cannot get orders

    def look(self, now_ns: int) -> None:
        """Kill the standby when it sends no heartbeats. The guardian calls this every ``LOOK_EVERY`` ticks, since a
        timer of its own would wake this process another 50 times per second."""
        process, detector = self.process, self._detector
        if process is None or detector is None:
            return
        detector.note_heartbeat(self._heartbeat.last_received_ns)
        late = not detector.last_received_ns and now_ns - self._began_ns > START_S * NS
        if late or detector.tick(now_ns):
            self._detector = None
            process.kill()

    @property
    def is_ready(self) -> bool:
        """Return True if a standby runs and has received the ids of the processes that it watches."""
        return self._watching and self.process is not None and self.process.alive

    # -- the processes that the standby watches

    def wire_started(self, process: ChildProcess) -> None:
        self._wire = process
        self._safety_page.wire_pid = process.pid
        if self._watching:
            with self._watch_message() as message:
                self._ref.tell(message)

    @contextlib.contextmanager
    def _watch_message(self) -> Iterator[WatchOver]:
        """Yield the message that names the processes to watch. The descriptors in it are closed at the end of the
        ``with`` block."""
        wire = self._wire if self._wire is not None and self._wire.alive else None
        # The system may soon use the id of an ended process for another one.
        self._safety_page.wire_pid = 0 if wire is None else wire.pid
        pidfds: list[int] = []
        # No file descriptor is free. The standby then uses the process ids instead of pidfds.
        with contextlib.suppress(OSError):
            if self._own_pidfd is not None:
                pidfds.append(os.dup(self._own_pidfd))
                pidfds += () if wire is None else wire.pidfds()
        try:
            yield WatchOver(os.getpid(), 0 if wire is None else wire.pid, (self._page, *pidfds))
        finally:
            for fd in pidfds:
                os.close(fd)

    async def _begin(self) -> None:
        """Send the standby the processes to watch, as soon as it answers. The wire process may have been replaced
        since the standby was started."""
        announced: ChildProcess | None = None
        answer: Message | None = None
        while not isinstance(answer, Guarding) or announced is not self._wire:
            announced = self._wire
            try:
                with self._watch_message() as message:
                    answer = await self._ref.ask(message, START_S)
            except (AskTimeout, Unreachable):
                await trio.sleep(ASK_AGAIN_S)
        self._watching = True
        self.on_begun()

    # -- the stop channel of the standby

    async def guard(self, descriptors: Sequence[int]) -> Refused | None:
        """Give the standby a stop channel, and wait for a standby that is being started. Return None when the
        channel is ready, or a refusal."""
        with trio.move_on_after(self._timing.handover_s - MARGIN_S):
            while True:
                if self._watching:
                    try:
                        answer = await self._ref.ask(Guard(tuple(descriptors)), self._timing.handover_s)
                    except (AskTimeout, Unreachable):
                        pass  # the standby has ended, and another one is being started
                    else:
                        return answer if isinstance(answer, Refused) else None
                await trio.sleep(ASK_AGAIN_S)
        return refusals.no_standby()

    async def release_channel(self) -> None:
        """Wait until the standby has closed its stop channel. Kill the standby if it does not."""
        process = self.process
        if process is None:
            return
        try:
            if isinstance(await self._ref.ask(LetGo(), LET_GO_S), LetGone):
                return
        except (AskTimeout, Unreachable):
            pass
        await process.fence()

    async def end(self) -> None:
        """End the standby, because all processes of the robot end."""
        self._leaving = True
        if self.process is not None:
            await self.process.fence()
