"""The wire group: gate, watchdog and transport, in one event loop that runs nothing else.

If one of the three actors fails, the whole group ends, and the root's guardian stops the robot. A failed actor is
never restarted alone.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.actor import describe
from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh
from strands_actors.kernel.channels.zenoh_session import hand_over
from strands_actors.kernel.clock import NS, Clock, MonotonicClock
from strands_actors.kernel.health.heartbeat import Heartbeat, words_of
from strands_actors.kernel.health.processor import ProcessorUse, StatFile, suspected
from strands_actors.kernel.health.realtime import WIRE_PRIORITY, run_first
from strands_actors.kernel.node import Node
from strands_actors.kernel.processes.child import report_failure
from strands_actors.kernel.processes.fork import ForkedAhead
from strands_actors.kernel.processes.identity import lower_oom_score, take_name
from strands_actors.kernel.processes.process import ChildProcess, start
from strands_actors.kernel.processes.reserve import RESERVE, how_ended
from strands_actors.kernel.supervisor import Budget, ChildSpec, Supervisor
from strands_actors.supervisors import addresses
from strands_actors.supervisors import permissions as channels
from strands_actors.supervisors.gate.failsafe import Mode, State
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.instrument import Attached, InstrumentKeeper, name_of
from strands_actors.supervisors.introspection import Introspector
from strands_actors.supervisors.loading import load_driver, without_secrets
from strands_actors.supervisors.mesh import policy_access
from strands_actors.supervisors.page import ROOT, STANDBY, WIRE, SafetyPage
from strands_actors.supervisors.root.messages import RecorderGap
from strands_actors.supervisors.root.stop_channel import LINGER_S, attempt_anew, none_unsafe, pauses_s, settled
from strands_actors.supervisors.wire.messages import RootGone

from .transport import Transport
from .watchdog import Watchdog

UNCONFIRMED = 4
"""Exit code of a wire process whose root is gone, when a motor did not confirm the safe state."""
STANDBY_LIVES_NS = NS
"""Root or standby count as running if a heartbeat is not older than this, in nanoseconds."""
LAST_MESSAGES_S = 0.05
"""Time for reading the last messages of a process from its link after it has ended, in seconds."""


async def run_group(
    node: Node,
    driver: Driver,
    robot: str,
    start_state: State,
    cause: str,
    orphaned: Callable[[bool], None],
    heartbeat: Heartbeat,
    root: Callable[[], ProcessorUse | None] = lambda: None,
    missed: Callable[[], None] = lambda: None,
    made: Callable[[Transport], None] = lambda _: None,
    locked_since: str = "",
    safety_page: SafetyPage | None = None,
    no_standby: str = "",
    audited: bool = False,
    secret: bytes = b"",
    task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED,
) -> None:
    """Run gate, watchdog and transport until cancelled. Raise an exception if one of them fails.

    Args:
        node: The node of this process, which runs its actors.
        driver: The driver of the robot.
        robot: Name of the robot.
        start_state: The first failsafe state.
        cause: The cause of that state.
        orphaned: Called after the root has ended and the robot was stopped (see ``Watchdog``).
        heartbeat: The heartbeats of wire and root.
        root: Returns whether the root process waits for a processor (see ``Watchdog``).
        missed: Called at a tick without a new heartbeat of the root (see ``Watchdog``).
        made: Called with the new transport.
        locked_since: When the robot was locked by an e-stop; empty if it is not locked.
        safety_page: The shared page on which root and standby read if anything may be energised.
        no_standby: Why nothing may be energised yet (see ``Gate``).
        audited: True to report every decision of the gate to the root, for the audit.
        secret: Key for the numbers of leases (see ``Gate``).
        task_status: Informed when the three actors run.
    """
    actors = addresses.of(robot)
    transport = Transport(
        driver,
        actors.gate,
        actors.watchdog,
        actors.guardian,
        start_state.epoch,
        start_state.mode is Mode.LOST,
        safety_page,
    )
    made(transport)
    cells = [
        node.cell(actors.path("transport"), lambda: transport),
        node.cell(
            actors.path("gate"),
            lambda: Gate(
                driver,
                actors.transport,
                actors.watchdog,
                actors.guardian,
                start_state,
                cause,
                locked_since,
                no_standby,
                audited,
                secret,
                0 if safety_page is None else safety_page.stopped_ns,
            ),
        ),
        node.cell(
            actors.path("watchdog"),
            lambda: Watchdog(
                driver.timing, actors.gate, actors.transport, orphaned, heartbeat, root, missed, driver.late_s
            ),
        ),
    ]
    try:
        supervisor = Supervisor([ChildSpec(cell.role, cell.run) for cell in cells], budget=Budget(restarts=0))
        await supervisor.run(task_status=task_status)
    finally:
        for cell in cells:
            node.release(cell)


def instrument_keeper(node: Node, driver: Driver, description: dict[str, Any], robot: str) -> InstrumentKeeper:
    """Make the actor to which a recorder of gate and watchdog connects."""
    actors = addresses.of(robot)

    def remember() -> Iterator[tuple[str, int, object]]:
        for address in (actors.gate, actors.watchdog):
            cell = node.cells.get(address)
            if cell is not None and isinstance(cell.actor, Gate | Watchdog):
                yield name_of(address), cell.actor.context.deferrals, cell.actor.memory()

    def on_gap(missed: int) -> None:
        node.ref(actors.guardian).tell(RecorderGap(missed))

    names = {address: name_of(address) for address in (actors.gate, actors.watchdog)}
    attached = Attached(without_secrets(description, type(driver)), driver.axes, driver.unit)
    return InstrumentKeeper(names, attached, remember, on_gap=on_gap)


class WireProcess:
    """The wire group (gate, watchdog and transport) in a child process, as the root uses it."""

    def __init__(self, node: Node, nursery: trio.Nursery, args: dict[str, Any], ahead: ForkedAhead) -> None:
        entry = "strands_actors.supervisors.wire.group:main"
        self.process: ChildProcess = ahead.start(entry, args) or start(entry, args, (args["page"],), args["label"])
        self._link = self.process.link(node, channels.of_wire(args["robot"]))
        self._stat = StatFile(self.process.pid)
        self._link_ended = trio.Event()
        self._code: int | None = None
        nursery.start_soon(self._carry)

    async def _carry(self) -> None:
        try:
            await self._link.run()
        except Exception as error:
            report_failure("the link to the wire process", error)
            self.process.kill()  # a wire process without a link cannot report to the root
        finally:
            self._link_ended.set()

    @property
    def alive(self) -> bool:
        return self.process.alive

    @property
    def ended_safe(self) -> bool:
        return self._code == 0

    async def ended(self) -> str:
        self._code = code = await self.process.wait()
        return f"the wire process ended with {how_ended(code)}"

    def dying(self) -> bool:
        return self._stat.life().dying

    async def fence(self) -> bool:
        fenced = await self.process.fence()
        with trio.move_on_after(LAST_MESSAGES_S if fenced else 0):
            await self._link_ended.wait()
        return fenced

    def close_link(self) -> None:
        self._link.close()

    def processor_use(self) -> ProcessorUse | None:
        return suspected(self.process.pid)


class InlineWire:
    """The wire group (gate, watchdog and transport) in this process, for tests. The clock may be virtual."""

    def __init__(
        self,
        node: Node,
        nursery: trio.Nursery,
        driver: Driver,
        robot: str,
        state: State,
        cause: str,
        heartbeat: Heartbeat,
        safety_page: SafetyPage | None = None,
    ) -> None:
        self._safety_page = safety_page or SafetyPage()
        self._scope = trio.CancelScope()
        self._ended = trio.Event()
        self._end_reason = "the wire group ended"
        self._watchdog = node.ref(addresses.of(robot).watchdog)
        self._link_closed = False
        self.ended_safe = False
        nursery.start_soon(self._run, node, driver, robot, state, cause, heartbeat)

    async def _run(
        self, node: Node, driver: Driver, robot: str, state: State, cause: str, heartbeat: Heartbeat
    ) -> None:
        transports: list[Transport] = []
        group = trio.CancelScope()

        def end(confirmed: bool) -> None:
            self.ended_safe = confirmed
            group.cancel()

        try:
            with self._scope:
                try:
                    with group:
                        await run_group(
                            node, driver, robot, state, cause, end, heartbeat,
                            made=transports.append, safety_page=self._safety_page,
                        )  # fmt: skip
                except Exception as error:
                    self._end_reason = describe(error)
                if self._link_closed and not self.ended_safe:
                    self.ended_safe = await make_safe_alone(driver, node.clock, transports, self._safety_page)
        finally:
            self._ended.set()

    @property
    def alive(self) -> bool:
        return not self._ended.is_set()

    def dying(self) -> bool:
        return False

    async def ended(self) -> str:
        await self._ended.wait()
        return self._end_reason

    async def fence(self) -> bool:
        self._scope.cancel()
        await self._ended.wait()
        return True

    def close_link(self) -> None:
        self._link_closed = True
        self._watchdog.tell(RootGone())

    def processor_use(self) -> None:
        return None  # the wire group runs in this process


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Run the wire process."""
    take_name(args["robot"], "wire", args["label"])
    lower_oom_score()
    hand_over()
    trio.run(_main, args, sock)


async def _main(args: dict[str, Any], sock: socket.socket) -> None:
    clock: Clock = MonotonicClock()
    robot: str = args["robot"]
    actors = addresses.of(robot)
    driver = load_driver(args["driver"])
    driver.preload_wire()
    run_first(WIRE_PRIORITY)
    node = Node(f"{robot}.wire.{os.getpid()}", clock)
    state = State(Mode(args["mode"]), args["epoch"], args["locked_by"])
    root_channel = channels.of_root(robot)
    node.linked = root_channel.hosts or frozenset()
    link = Link(node, sock, lambda: node.ref(actors.watchdog).tell(RootGone()), root_channel)

    root = os.getppid()
    root_stat = StatFile(root)
    words = words_of(args["page"])
    heartbeat = Heartbeat(words, WIRE, ROOT)
    safety_page = SafetyPage(words)
    transports: list[Transport] = []
    standby = Heartbeat(words, WIRE, STANDBY)
    RESERVE.begin(
        lambda: clock.now_ns() < max(standby.last_received_ns, heartbeat.last_received_ns) + STANDBY_LIVES_NS
    )

    async def join_mesh() -> None:
        mesh = await ZenohMesh.open((), args["connect"], secret=args["secret"])
        mesh.channel = channels.of_caller(robot, args["caller"])
        mesh.attach(node)
        visited = channels.of_visitors(robot, "wire")
        guests = channels.of_guests(robot, args["is_hosted"])
        await mesh.let_guests_in(args["listen"], guests, visited, channels.shown(robot))
        await mesh.run()

    async def let_policies_in() -> None:
        rules, secret = policy_access.settings(robot), args["policy_secret"]
        mesh = await ZenohMesh.open([args["policy_listen"]], settings=rules, secret=secret)
        mesh.channel = channels.of_policy(robot, policy_access.WRITER)
        mesh.let_in(node, actors.gate)
        await mesh.run()

    def check_root() -> None:
        if root_stat.life().dying:
            node.ref(actors.watchdog).tell(RootGone())

    try:
        async with trio.open_nursery() as nursery:

            def end(confirmed: bool) -> None:
                if confirmed:
                    os._exit(0)
                nursery.cancel_scope.cancel()

            await nursery.start(node.run)
            await nursery.start(
                run_group, node, driver, robot, state, args["cause"], end, heartbeat, lambda: suspected(root),
                check_root, transports.append, args["locked_since"], safety_page,
                "the root has not reported yet that it is ready", args["audited"], os.urandom(16),
            )  # fmt: skip
            nursery.start_soon(link.run)
            nursery.start_soon(join_mesh)
            nursery.start_soon(let_policies_in)
            nursery.start_soon(node.cell(actors.introspection("wire"), Introspector, "introspection").run)
            instrument = node.cell(
                actors.instrument("wire"),
                lambda: instrument_keeper(node, driver, args["driver"], robot),
                "instrument",
            )
            nursery.start_soon(instrument.run)
    except Exception as error:
        if not (link.closed or os.getppid() != root):
            # If the root still runs, it stops the robot now, as it does whenever this process ends.
            raise
        report_failure("the wire process, whose root is gone,", error)
    async with trio.open_nursery() as nursery:
        nursery.start_soon(_beat, heartbeat, clock, driver.timing.tick_s)
        confirmed = await make_safe_alone(driver, clock, transports, safety_page)
        nursery.cancel_scope.cancel()
    if confirmed:
        safety_page.may_be_energised = False
    os._exit(0 if confirmed else UNCONFIRMED)


async def _beat(heartbeat: Heartbeat, clock: Clock, tick_s: float) -> None:
    """Send heartbeats to the standby, so that it does not act while this process stops the robot. The watchdog,
    which normally sends them, has ended."""
    while True:
        heartbeat.beat(clock.now_ns())
        await trio.sleep(tick_s)


async def make_safe_alone(
    driver: Driver, clock: Clock, transports: Sequence[Transport], safety_page: SafetyPage
) -> bool:
    """Stop the robot without root, gate and transport. This is done when the root has ended and gate and transport
    could not stop the robot.

    The stop is repeated until every motor confirms it or ``LINGER_S`` have passed.

    Args:
        driver: The driver of the robot.
        clock: The clock.
        transports: The transport that ran, or an empty list.
        safety_page: The shared page.

    Returns:
        True if every motor has confirmed the stop.
    """
    safe_state = safety_page.order(driver.fallbacks[Reason.ROOT])
    descriptors: tuple[int, ...] = ()
    # If no file descriptor is free, the port is opened again instead.
    with contextlib.suppress(OSError):
        descriptors = transports[-1].descriptors() if transports else ()
    with trio.move_on_after(LINGER_S):
        for pause_s in pauses_s():
            make_safe = partial(attempt_anew, driver, clock, safe_state, descriptors)
            if none_unsafe(await settled(safety_page, clock, make_safe)):
                return True
            if safety_page.is_asking:
                # A thread of an SDK runs until this process ends. So end now, and let the standby stop the robot.
                return False
            RESERVE.end_if_short()
            if descriptors:
                # The port is locked, so close it before it is opened again.
                transports[-1].close()
                descriptors = ()
            await trio.sleep(pause_s)
    return False
