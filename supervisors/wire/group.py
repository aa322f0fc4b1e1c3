"""The wire group: gate, watchdog and transport, in one loop that runs nothing else.

If one of the three fails, the whole group ends and the guardian takes over. The group is never repaired in
part.
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
from strands_actors.kernel.health.processor import Standing, StatFile, suspected
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
from strands_actors.supervisors.page import ROOT, STANDBY, WIRE, Owed
from strands_actors.supervisors.root.stop_channel import LINGER_S, all_safe, attempt_anew, pauses_s, settled
from strands_actors.supervisors.wire.messages import RootGone

from .transport import Transport
from .watchdog import Watchdog

UNCONFIRMED = 4
"""Exit code of a wire process whose root is gone, when a motor did not confirm the safe state."""
STANDBY_LIVES_NS = NS
"""A root or standby with a heartbeat in this time (ns) counts as running."""
LAST_HEARD_S = 0.05
"""Time (s) to read the last messages of a process from its link after its end."""


async def run_group(
    node: Node,
    driver: Driver,
    robot: str,
    start_state: State,
    cause: str,
    orphaned: Callable[[bool], None],
    heartbeat: Heartbeat,
    root: Callable[[], Standing | None] = lambda: None,
    missed: Callable[[], None] = lambda: None,
    made: Callable[[Transport], None] = lambda _: None,
    locked_since: str = "",
    owed: Owed | None = None,
    no_standby: str = "",
    audited: bool = False,
    secret: bytes = b"",
    task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED,
) -> None:
    """Run until cancelled. Raise if one of the three actors fails.

    Args:
        node: The node of this process.
        driver: The driver of the robot.
        robot: The robot's name.
        start_state: The failsafe state to begin with.
        cause: The cause of that state.
        orphaned: See ``Watchdog``.
        heartbeat: The heartbeats of wire and root.
        root: See ``Watchdog``.
        missed: See ``Watchdog``.
        made: Called with the transport.
        locked_since: See ``Gate``, as for the following ones.
        owed: See ``Transport``.
        no_standby: Why nothing is armed yet.
        audited: True if decisions go to the audit.
        secret: See ``Gate``.
    """
    at = addresses.of(robot)
    transport = Transport(
        driver, at.gate, at.watchdog, at.guardian, start_state.epoch, start_state.mode is Mode.LOST, owed
    )
    made(transport)
    cells = [
        node.cell(at.path("transport"), lambda: transport),
        node.cell(
            at.path("gate"),
            lambda: Gate(
                driver,
                at.transport,
                at.watchdog,
                at.guardian,
                start_state,
                cause,
                locked_since,
                no_standby,
                audited,
                secret,
                0 if owed is None else owed.stopped_ns,
            ),
        ),
        node.cell(
            at.path("watchdog"),
            lambda: Watchdog(
                driver.timing, at.gate, at.transport, orphaned, heartbeat, root, missed, driver.late_s
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
    """Return the actor to which a recorder of gate and watchdog attaches."""
    at = addresses.of(robot)

    def remember() -> Iterator[tuple[str, int, object]]:
        for address in (at.gate, at.watchdog):
            cell = node.cells.get(address)
            if cell is not None and isinstance(cell.actor, Gate | Watchdog):
                yield name_of(address), cell.actor.context.deferrals, cell.actor.memory()

    names = {address: name_of(address) for address in (at.gate, at.watchdog)}
    attached = Attached(without_secrets(description, type(driver)), driver.axes, driver.unit)
    return InstrumentKeeper(names, attached, remember)


class WireProcess:
    """The wire group in a child process."""

    def __init__(self, node: Node, nursery: trio.Nursery, args: dict[str, Any], ahead: ForkedAhead) -> None:
        entry = "strands_actors.supervisors.wire.group:main"
        self.process: ChildProcess = ahead.start(entry, args) or start(entry, args, (args["page"],), args["label"])
        self._link = self.process.link(node, channels.of_wire(args["robot"]))
        self._stat = StatFile(self.process.pid)
        self._heard_out = trio.Event()
        self._code: int | None = None
        nursery.start_soon(self._carry)

    async def _carry(self) -> None:
        try:
            await self._link.run()
        except Exception as error:
            report_failure("the link to the wire process", error)
            self.process.kill()  # without a link it cannot report
        finally:
            self._heard_out.set()

    @property
    def alive(self) -> bool:
        return self.process.alive

    @property
    def left_safe(self) -> bool:
        return self._code == 0

    async def ended(self) -> str:
        self._code = code = await self.process.wait()
        return f"the wire process ended with {how_ended(code)}"

    def dying(self) -> bool:
        return self._stat.life().dying

    async def fence(self) -> bool:
        fenced = await self.process.fence()
        with trio.move_on_after(LAST_HEARD_S if fenced else 0):
            await self._heard_out.wait()
        return fenced

    def let_go(self) -> None:
        self._link.close()

    def standing(self) -> Standing | None:
        return suspected(self.process.pid)


class InlineWire:
    """The wire group in the loop of this process, for tests, also in virtual time."""

    def __init__(
        self,
        node: Node,
        nursery: trio.Nursery,
        driver: Driver,
        robot: str,
        state: State,
        cause: str,
        heartbeat: Heartbeat,
        owed: Owed | None = None,
    ) -> None:
        self._owed = owed or Owed()
        self._scope = trio.CancelScope()
        self._ended = trio.Event()
        self._why = "the wire group ended"
        self._watchdog = node.ref(addresses.of(robot).watchdog)
        self._let_go = False
        self.left_safe = False
        nursery.start_soon(self._run, node, driver, robot, state, cause, heartbeat)

    async def _run(
        self, node: Node, driver: Driver, robot: str, state: State, cause: str, heartbeat: Heartbeat
    ) -> None:
        transports: list[Transport] = []
        group = trio.CancelScope()

        def end(confirmed: bool) -> None:
            self.left_safe = confirmed
            group.cancel()

        try:
            with self._scope:
                try:
                    with group:
                        await run_group(
                            node, driver, robot, state, cause, end, heartbeat,
                            made=transports.append, owed=self._owed,
                        )  # fmt: skip
                except Exception as error:
                    self._why = describe(error)
                if self._let_go and not self.left_safe:
                    self.left_safe = await make_safe_alone(driver, node.clock, transports, self._owed)
        finally:
            self._ended.set()

    @property
    def alive(self) -> bool:
        return not self._ended.is_set()

    def dying(self) -> bool:
        return False

    async def ended(self) -> str:
        await self._ended.wait()
        return self._why

    async def fence(self) -> bool:
        self._scope.cancel()
        await self._ended.wait()
        return True

    def let_go(self) -> None:
        self._let_go = True
        self._watchdog.tell(RootGone())

    def standing(self) -> None:
        return None  # it runs in this process


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Run the wire process."""
    take_name(args["robot"], "wire", args["label"])
    lower_oom_score()
    hand_over()
    trio.run(_main, args, sock)


async def _main(args: dict[str, Any], sock: socket.socket) -> None:
    clock: Clock = MonotonicClock()
    robot: str = args["robot"]
    at = addresses.of(robot)
    driver = load_driver(args["driver"])
    driver.preload_wire()
    run_first(WIRE_PRIORITY)
    node = Node(f"{robot}.wire.{os.getpid()}", clock)
    state = State(Mode(args["mode"]), args["epoch"], args["locked_by"])
    root_channel = channels.of_root(robot)
    node.linked = root_channel.hosts or frozenset()
    link = Link(node, sock, lambda: node.ref(at.watchdog).tell(RootGone()), root_channel)

    root = os.getppid()
    root_stat = StatFile(root)
    words = words_of(args["page"])
    heartbeat = Heartbeat(words, WIRE, ROOT)
    owed = Owed(words)
    transports: list[Transport] = []
    standby = Heartbeat(words, WIRE, STANDBY)
    RESERVE.begin(lambda: clock.now_ns() < max(standby.heard_ns, heartbeat.heard_ns) + STANDBY_LIVES_NS)

    async def join_mesh() -> None:
        mesh = await ZenohMesh.open((), args["connect"], secret=args["secret"])
        mesh.channel = channels.of_caller(robot, args["caller"])
        mesh.attach(node)
        visited = channels.of_visitors(robot, "wire")
        await mesh.let_guests_in(args["listen"], channels.of_user(robot), visited, channels.shown(robot))
        await mesh.run()

    async def let_policies_in() -> None:
        rules, secret = policy_access.settings(robot), args["policy_secret"]
        mesh = await ZenohMesh.open([args["policy_listen"]], settings=rules, secret=secret)
        mesh.channel = channels.of_policy(robot, policy_access.WRITER)
        mesh.let_in(node, at.gate)
        await mesh.run()

    def look_at_root() -> None:
        if root_stat.life().dying:
            node.ref(at.watchdog).tell(RootGone())

    try:
        async with trio.open_nursery() as nursery:

            def end(confirmed: bool) -> None:
                if confirmed:
                    os._exit(0)
                nursery.cancel_scope.cancel()

            await nursery.start(node.run)
            await nursery.start(
                run_group, node, driver, robot, state, args["cause"], end, heartbeat, lambda: suspected(root),
                look_at_root, transports.append, args["locked_since"], owed,
                "none has said so far that it is ready", args["audited"], os.urandom(16),
            )  # fmt: skip
            nursery.start_soon(link.run)
            nursery.start_soon(join_mesh)
            nursery.start_soon(let_policies_in)
            nursery.start_soon(node.cell(at.introspection("wire"), Introspector, "introspection").run)
            instrument = node.cell(
                at.instrument("wire"), lambda: instrument_keeper(node, driver, args["driver"], robot), "instrument"
            )
            nursery.start_soon(instrument.run)
    except Exception as error:
        if not (link.closed or os.getppid() != root):
            raise  # the root stops the robot, as after any end of this process
        report_failure("the wire process, whose root is gone,", error)
    async with trio.open_nursery() as nursery:
        nursery.start_soon(_beat, heartbeat, clock, driver.timing.tick_s)
        confirmed = await make_safe_alone(driver, clock, transports, owed)
        nursery.cancel_scope.cancel()
    if confirmed:
        owed.safe_state = False
    os._exit(0 if confirmed else UNCONFIRMED)


async def _beat(heartbeat: Heartbeat, clock: Clock, tick_s: float) -> None:
    """Send heartbeats to the standby: this process still works, although its watchdog has ended."""
    while True:
        heartbeat.beat(clock.now_ns())
        await trio.sleep(tick_s)


async def make_safe_alone(driver: Driver, clock: Clock, transports: Sequence[Transport], owed: Owed) -> bool:
    """Stop the robot without root, gate and transport, because the root is gone and the others could not stop
    it.

    Attempts are repeated until every motor confirms the stop or ``LINGER_S`` are over.

    Args:
        driver: The driver of the robot.
        clock: The clock.
        transports: The transport that ran, if any.
        owed: The shared page.

    Returns:
        True if every motor has confirmed.
    """
    safe_state = owed.order(driver.fallbacks[Reason.ROOT])
    descriptors: tuple[int, ...] = ()
    with contextlib.suppress(OSError):  # no descriptor is left, so the port is opened again
        descriptors = transports[-1].descriptors() if transports else ()
    with trio.move_on_after(LINGER_S):
        for pause_s in pauses_s():
            make_safe = partial(attempt_anew, driver, clock, safe_state, descriptors)
            if all_safe(await settled(owed, clock, make_safe)):
                return True
            if owed.is_asking:
                # A thread of an SDK continues until this process ends. The standby stops the robot after that.
                return False
            RESERVE.end_if_short()
            if descriptors:
                # The port can be opened again only after it was closed.
                transports[-1].close()
                descriptors = ()
            await trio.sleep(pause_s)
    return False
