"""The root process: it starts and watches all other processes of one robot.

It runs no numpy, no SDK and no user code. It belongs to the script that started it. When the script ends for any
reason, the root stops the robot and ends all processes.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import trio

from strands_actors.contract.driver import Reason
from strands_actors.kernel.actor import Actor, Cell, Deferred, describe, read_protocols
from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh
from strands_actors.kernel.channels.zenoh_session import hand_over
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.health.heartbeat import Heartbeat, words_of
from strands_actors.kernel.health.kernel_workers import keep_them_early
from strands_actors.kernel.health.realtime import ROOT_PRIORITY, run_first, run_like_others
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import AskTimeout, Node, Ref, Unreachable
from strands_actors.kernel.processes.child import exit_code, report_failure
from strands_actors.kernel.processes.fork import ForkedAhead
from strands_actors.kernel.processes.identity import lower_oom_score, take_name
from strands_actors.kernel.processes.process import wait_for_end_of
from strands_actors.kernel.processes.reserve import RESERVE, end, lacks_resources, raise_limits
from strands_actors.kernel.processes.spawner import Spawner
from strands_actors.kernel.supervisor import Budget, BudgetSpent, ChildSpec, Supervisor
from strands_actors.supervisors import addresses
from strands_actors.supervisors import permissions as channels
from strands_actors.supervisors.deadlines import StopDeadlines, settle_s
from strands_actors.supervisors.gate.failsafe import LINKED, Mode, State
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import Stop, StopReport
from strands_actors.supervisors.instrument import Attached, InstrumentKeeper, name_of
from strands_actors.supervisors.introspection import Introspector
from strands_actors.supervisors.loading import import_ours, load_driver, without_secrets
from strands_actors.supervisors.mesh.service import MeshService
from strands_actors.supervisors.page import ROOT, STANDBY, WIRE, SafetyPage
from strands_actors.supervisors.root.messages import (
    ActorInfo,
    AttachProgram,
    Describe,
    EpisodeState,
    GetMesh,
    GetTask,
    Happened,
    Hosted,
    Introspection,
    OnMesh,
    ProcessInfo,
    Shutdown,
    StateIs,
    TaskStatus,
    TreeReport,
)
from strands_actors.supervisors.wire.group import UNCONFIRMED, WireProcess
from strands_actors.supervisors.wire.watchdog import Tick

from .attached import AttachedPrograms
from .audit import Audit
from .camera_keeper import CameraKeeper
from .guardian import Guardian
from .lock_keeper import KEEP_S, LockKeeper
from .locks import Locks
from .standby_keeper import StandbyKeeper
from .stop_channel import not_reached
from .tasks import Tasks

WIRE_BUDGET = Budget(restarts=3, within_s=5.0, backoff_s=0.05)
LAST_WORDS_S = 0.02
"""Time for the last messages to leave before the process exits."""
ACTORS_BUDGET = Budget(restarts=3, within_s=5.0, backoff_s=0.05)

HOST = "host"
"""The role of a process that keeps robots for other programs (``strands-actors up``)."""

_DULL = frozenset({Tick, Describe, TreeReport, GetTask, TaskStatus, EpisodeState})


class Root(Actor):
    """Describe the robot's processes, and end them on request."""

    def __init__(self, tree: Tree) -> None:
        self._tree = tree

    def receive(
        self, message: Describe | GetMesh | AttachProgram | Shutdown
    ) -> TreeReport | OnMesh | Hosted | StopReport | Refused | Deferred | None:
        if isinstance(message, AttachProgram):
            self._tree.attached.watch(message.pid)
            return Hosted(self._tree.args["hosted"])
        deferred = self.context.defer()
        match message:
            case Describe():
                self.context.start_soon(self._describe, deferred)
            case GetMesh():
                self.context.start_soon(self._tell_mesh, deferred)
            case Shutdown():
                self._tree.shut_down(message.reason, message.by, deferred)
        return deferred

    async def _tell_mesh(self, deferred: Deferred) -> None:
        await self._tree.mesh.settled.wait()
        deferred.send(OnMesh(self._tree.mesh.problem))

    async def _describe(self, deferred: Deferred) -> None:
        deferred.send(await self._tree.describe(self.context.address))


class Unconfirmed:
    """Write the names of the motors that have not confirmed a stop into ``note``, the root's file in the run
    directory."""

    def __init__(self, note: str) -> None:
        self._note = Path(note)
        self._written_motors: list[str] = []
        self._writing = threading.Lock()

    def tell(self, report: StopReport) -> None:
        """Write the motors that a report of a stop names as unconfirmed. A thread does this, so that a slow disk
        delays no stop."""
        motors = report.unconfirmed
        if motors == self._written_motors:
            return
        before, self._written_motors = self._written_motors, motors
        try:
            threading.Thread(target=self._write, daemon=True).start()
        # No thread could be started. The next report tries again.
        except RuntimeError as error:
            self._written_motors = before
            report_failure("the note on unconfirmed motors", error)

    def _write(self) -> None:
        run_like_others()
        # The lock keeps the order, so that the newest list is written last.
        with self._writing:
            self._write_note(self._written_motors)

    def _write_note(self, motors: list[str]) -> None:
        try:
            note = msgspec.json.decode(self._note.read_bytes())
            draft = self._note.with_suffix(".root.tmp")
            draft.write_bytes(msgspec.json.encode({**note, "unconfirmed": motors}))
            draft.replace(self._note)
        except (OSError, msgspec.MsgspecError, TypeError) as error:
            report_failure("the note on unconfirmed motors", error)


class Ahead(NamedTuple):
    """The processes that the root has forked before it started a thread: the spawner, the first wire process and
    the standby. ``page`` is the shared memory that the last two use."""

    spawner: Spawner
    # The first wire process. A later one cannot be forked from this process, since it has threads then.
    wire: ForkedAhead
    standby: ForkedAhead
    page: int


class Tree:
    """All parts of the root process of one robot."""

    def __init__(self, args: dict[str, Any], ahead: Ahead) -> None:
        spawner = self.spawner = ahead.spawner
        self.ahead = ahead
        words = words_of(ahead.page)
        self.robot: str = args["robot"]
        self.args = args
        self.actors = addresses.of(self.robot)
        self.driver = load_driver(args["driver"])
        # A part of a robot is commanded by an attached program, as the robot of a host is. But it has no host.
        self.is_hosted = args.get("hosted") is not None
        self.has_host = self.is_hosted and not args.get("is_part", False)
        run_first(ROOT_PRIORITY)
        self.node = Node(f"{self.robot}.root.{os.getpid()}", MonotonicClock())
        # Accept messages of the wire's actors only on the link to the wire process. Do not look for these actors
        # elsewhere.
        self.node.linked = channels.of_wire(self.robot).hosts or frozenset()
        self._policy_secret = secrets.token_hex(16)
        self.audit = Audit(Path(args["audit"]) if args["audit"] else None)
        self.tasks = Tasks(
            self.robot,
            spawner.start,
            args["policy_listen"],
            args["label"],
            self.driver.timing.safe_s,
            args.get("policy_limits"),
            self.audit.note,
            self._policy_secret,
        )
        self.cameras = CameraKeeper(
            self.node,
            self.robot,
            args.get("cameras", ()),
            spawner.start,
            lambda: self.guardian.state.mode in LINKED,
        )
        rings = (lambda: self.cameras.rings) if args.get("cameras") else None
        self.mesh = MeshService(
            self.node,
            self.robot,
            self.driver,
            lambda: self.tasks.status,
            rings,
            self.audit.note,
            lambda: self.restarts,
            lambda: self.recorder_gaps,
        )
        self.keeper = LockKeeper(Locks(Path(args["locks"]), self.robot, args["lock_port"]))
        self.safety_page = SafetyPage(words)
        self.standby = StandbyKeeper(
            self.node,
            self.robot,
            {name: args[name] for name in ("robot", "driver", "label")} | args["standby"],
            ahead.page,
            self.safety_page,
            Heartbeat(words, ROOT, STANDBY),
            self.driver.timing,
            ahead.standby,
            spawner,
        )
        self.guardian = Guardian(
            self.driver,
            Heartbeat(words, ROOT, WIRE),
            self.start_wire,
            self._on_state,
            self.actors.gate,
            self.writers,
            self.keeper,
            Unconfirmed(args["note"]).tell,
            self._see_dying,
            self.standby,
            self.actors.transport,
            self.safety_page,
            lambda decided: self.audit.note(decided.sender, decided.order, decided.result, decided.over),
            RESERVE.end_if_short,
            self._see_suspended,
            self._note_gap,
            self.standby.look,
        )
        self.attached = AttachedPrograms(
            lambda: self.node.ref(self.actors.gate, Gate),
            lambda run, pid: self._keep("the watch over an attached program", run, pid),
        )
        self.standby.on_lost = self.guardian.lose_standby
        self.standby.on_begun = self.guardian.begin_standby
        RESERVE.begin(lambda: self.standby.is_ready)
        self.wire: WireProcess | None = None
        self.recorder_gaps = {"recorder_gaps": 0, "recorder_missed": 0}
        self._instrument: InstrumentKeeper | None = None  # the actor to which a recorder of this process connects
        self.supervisor = Supervisor([ChildSpec("wire", self.guardian.keep)], budget=WIRE_BUDGET)
        self.failed = ""
        self._shutdown = trio.Event()
        self._end: tuple[Reason, str] = (Reason.CLEANUP, "")
        self._waiting: list[Deferred] = []

    def start_wire(self, state: State, cause: str) -> WireProcess:
        args = {
            "robot": self.robot,
            "driver": self.args["driver"],
            "mode": state.mode,
            "epoch": state.epoch,
            "locked_by": state.locked_by,
            "locked_since": self.keeper.since,
            "cause": cause,
            "listen": [self.args["wire_listen"]],
            "connect": self.args["connect"],
            "secret": self.args["secret"],
            "caller": self.args["caller"],
            "policy_listen": self.args["policy_listen"],
            "policy_secret": self._policy_secret,
            "audited": bool(self.args["audit"]),
            "page": self.ahead.page,
            "label": self.args["label"],
            "is_hosted": self.is_hosted,
        }
        self.wire = WireProcess(self.node, self.nursery, args, self.ahead.wire)
        self.standby.wire_started(self.wire.process)
        self.guardian.context.note(Happened("the wire process was started", cause, self.wire.process.pid))
        return self.wire

    def _on_state(self, state: StateIs) -> None:
        if state.locked_by:
            self.tasks.end(f"e-stopped by {state.locked_by}")
        self.mesh.tell_state(state)

    def writers(self) -> list[int]:
        """Return the ids of the processes that may have sent setpoints."""
        policy = self.tasks.process
        policies = () if policy is None else (policy.pid,)
        return [self.args["caller_pid"], *policies, *self.attached.pids]

    def instrument_keeper(self) -> InstrumentKeeper:
        """Make the actor to which a recorder of the root's actors connects. Heartbeats are not recorded."""
        actors, driver = self.actors, self.driver
        names = {address: name_of(address) for address in (actors.guardian, actors.tasks, actors.root)}
        description = without_secrets(self.args["driver"], type(driver))
        attached = Attached(description, driver.axes, driver.unit)
        self._instrument = InstrumentKeeper(names, attached, dull=_DULL, on_gap=self._note_gap)
        return self._instrument

    def _note_gap(self, missed: int) -> None:
        self.recorder_gaps["recorder_gaps"] += 1
        self.recorder_gaps["recorder_missed"] += missed

    async def run(self, sock: socket.socket) -> None:
        async with trio.open_nursery() as nursery:
            self.nursery = nursery
            await nursery.start(self.node.run)
            await nursery.start(self._contain, "the spawner's reports", self.spawner.run)
            guardian = self.node.cell(self.actors.path("guardian"), lambda: self.guardian)
            await nursery.start(self._contain, "the guardian", guardian.run)
            await nursery.start(self._contain, "the actors", Supervisor(self._actors(), budget=ACTORS_BUDGET).run)
            self._keep("the keeper of the lock", self.keeper.run)
            self._keep("the audit", self.audit.run)
            self._keep("the keeper of the standby", self.standby.keep)
            self._keep("the watch over the caller", self._watch_caller, self.args["caller_pid"])
            link = Link(
                self.node,
                sock,
                lambda: self.shut_down(Reason.CALLER, "the caller ended"),
                channels.of_caller(self.robot, self.args["caller"]),
            )
            self._keep("the link to the caller", link.run)
            self._keep("the supervisor of the wire", self._supervise)
            self._keep("the keeper of the cameras", self.cameras.run)
            if self.driver.PORT_KIND == "serial":
                self._keep("the kernel's workers", keep_them_early)
            self._keep("the mesh of the actors", self._join_mesh)
            mesh: dict[str, Any] = self.args["mesh"]
            self._keep("the service on the mesh", self.mesh.run, mesh["listen"], mesh["connect"], mesh["settings"])
            await self._shutdown.wait()
            await self._leave()

    def _actors(self) -> list[ChildSpec]:
        """Return the specifications of all actors except the guardian. The supervisor restarts an actor that
        fails."""
        actors, cell = self.actors, self.node.cell
        cells = [
            cell(actors.path("tasks"), lambda: self.tasks),
            cell(actors.path("root"), lambda: Root(self)),
            cell(actors.introspection("root"), Introspector, "introspection"),
            cell(actors.instrument("root"), self.instrument_keeper, "instrument"),
        ]
        return [ChildSpec(each.role, partial(self._run_actor, each)) for each in cells]

    async def _run_actor(self, cell: Cell, task_status: trio.TaskStatus[None]) -> None:
        try:
            await cell.run(task_status)
        except Exception as error:
            report_failure(cell.address, error)
            raise

    async def _contain(
        self,
        label: str,
        run: Callable[..., Awaitable[None]],
        task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED,
    ) -> None:
        """Run one part of the root process. If it fails, end the robot's processes.

        After most exceptions this is done in order: the robot is stopped first. After two kinds of failures, the
        root process exits at once, and the wire or the standby process stops the robot.

        * An exit (``SystemExit`` and the like). In an orderly end it would close all sessions first, which takes 70
          ms. During this time the root would send no heartbeats, and the other processes would not see that it has
          ended.
        * A lack of files, memory or threads. An orderly end needs these, too. The wire and the standby process have
          their own.
        """
        try:
            await (run() if task_status is trio.TASK_STATUS_IGNORED else run(task_status=task_status))
        except Exception as error:
            report_failure(label, error)
            if lacks_resources(error):
                end(describe(error))
            self.failed = f"{label} failed: {describe(error)}"
            self.shut_down(Reason.ROOT, self.failed)
        except BaseException as error:
            if not _is_end_of_task(error):
                os._exit(exit_code(error))
            raise

    def _keep(self, label: str, run: Callable[..., Awaitable[None]], *args: Any) -> None:
        self.nursery.start_soon(self._contain, label, partial(run, *args))

    async def _supervise(self) -> None:
        try:
            await self.supervisor.run()
        except* BudgetSpent as error:
            # The guardian has stopped the robot at each end of a wire process. Once every motor has confirmed it,
            # the robot stays stopped.
            self.failed = describe(error)
            await self.guardian.keep_stopping()

    async def _join_mesh(self) -> None:
        mesh = await ZenohMesh.open((), self.args["connect"], secret=self.args["secret"])
        mesh.channel = channels.of_caller(self.robot, self.args["caller"])
        mesh.attach(self.node)
        await mesh.let_guests_in(
            [self.args["listen"]],
            channels.of_guests(self.robot, self.is_hosted),
            channels.of_visitors(self.robot, "root"),
            channels.shown(self.robot),
        )
        await mesh.run()

    async def _watch_caller(self, pid: int) -> None:
        await wait_for_end_of(pid)
        self.shut_down(Reason.CALLER, "the caller ended")

    # -- the end of the robot's processes

    def _see_dying(self, pid: int) -> None:
        """React to a writer's process that was killed, before the operating system reports its end. On a busy
        machine a killed process may wait tens of milliseconds for a processor before it exits."""
        if pid == self.args["caller_pid"]:
            self.shut_down(Reason.CALLER, "the caller was killed")
        elif pid in self.attached.pids:
            self.attached.end(pid)
        elif self.tasks.status.running:
            self.node.ref(self.actors.gate).tell(Stop(Reason.POLICY, "its process was killed"))

    def _see_suspended(self, pid: int) -> None:
        """End the robot's processes if the system has suspended their host (SIGSTOP). Otherwise a suspended host
        could neither end nor restart them, and no person would notice."""
        if self.has_host and pid == self.args["caller_pid"]:
            self.shut_down(Reason.CALLER, "the host is suspended")

    def shut_down(self, reason: Reason, by: str, deferred: Deferred | None = None) -> None:
        if deferred is not None:
            self._waiting.append(deferred)
        if not self._shutdown.is_set():
            self._end = reason, by
            self._shutdown.set()

    async def _leave(self) -> None:
        """End all processes of the robot.

        First the gate stops the robot, then the wire process ends. The guardian stops the robot once more, unless
        the gate's stop was confirmed and the wire process has ended by itself after that. While a motor is
        unconfirmed, this process repeats the stop for ``LINGER_S``.
        """
        reason, by = self._end
        self.guardian.leave()
        report = await self._stop_by_gate(reason, by)
        self.cameras.end()
        if self.tasks.process is not None:
            self.tasks.process.kill()
        with trio.move_on_after(StopDeadlines.of(self.driver.timing.safe_s).attempt_s + self._settle_s()):
            await self.guardian.end(reason, by, report is not None)
        if not self.guardian.confirmed or report is None:
            report = self._report_of_guardian(reason)
        for waiting in self._waiting:
            waiting.send(report)
        self._waiting.clear()
        await self.guardian.idle.wait()
        for waiting in self._waiting:  # orders to end the processes that came during this method
            waiting.send(self.guardian.last_report or report)
        await self.keeper.settle()
        with trio.move_on_after(KEEP_S):
            await self.audit.settle()
        await trio.sleep(LAST_WORDS_S)
        while self.guardian.is_stopping:  # an e-stop may come in these last moments
            await self.guardian.serve_waiting()
            await trio.sleep(LAST_WORDS_S)
        # End the standby last. It has the robot's port open, and can stop the robot until now.
        await self.standby.end()
        os._exit(0 if self.guardian.confirmed else UNCONFIRMED)

    async def _stop_by_gate(self, reason: Reason, by: str) -> StopReport | None:
        """Let the gate stop the robot. Return its report if every motor is confirmed. After that, the gate accepts
        no orders."""
        within_s = StopDeadlines.of(self.driver.timing.safe_s).own_stop_s + self._settle_s()
        try:
            answer = await self.node.ref(self.actors.gate, Gate).ask(Stop(reason, by), within_s)
        except (AskTimeout, Unreachable):
            return None
        if not isinstance(answer, StopReport) or not answer.confirmed:
            return None
        await trio.sleep(LAST_WORDS_S)
        return answer

    def _settle_s(self) -> float:
        """Return how much longer this stop may take, because an earlier request may still take effect."""
        timing = self.driver.timing
        return settle_s(timing.safe_s, self.safety_page.unsettled_s(self.node.clock.now_ns()))

    def _report_of_guardian(self, reason: Reason) -> StopReport:
        report = self.guardian.last_report
        if self.guardian.reported.is_set() and report is not None:
            return report
        safe_state = self.driver.fallbacks[Reason.WIRE]
        motors = not_reached(self.driver, "no report yet")
        return StopReport(reason, safe_state, self.guardian.state.epoch, False, motors, "stop_channel")

    # -- the description of the robot's processes

    @property
    def restarts(self) -> dict[str, int]:
        """Return how often each process was started again. A policy process is started for each task."""
        cameras = {f"camera/{name}": starts for name, starts in self.cameras.starts.items()}
        starts = {"standby": self.standby.starts, "policy": self.tasks.starts, **cameras}
        again = {process: max(0, count - 1) for process, count in starts.items()}
        return {"wire": self.supervisor.restarts.get("wire", 0), **again}

    async def describe(self, asker: str) -> TreeReport:
        state = self.guardian.state
        mode = Mode.FAILED if self.failed else Mode(state.mode)
        restarts = self.restarts
        report = [
            ProcessInfo(HOST if self.has_host else "caller", self.args["caller_pid"], 0),
            ProcessInfo("root", os.getpid(), 0),
            ProcessInfo("spawner", self.spawner.pid, 0),
        ]
        if self.wire is not None and self.wire.process.alive:
            report.append(ProcessInfo("wire", self.wire.process.pid, restarts["wire"]))
        if self.standby.process is not None:
            report.append(ProcessInfo("standby", self.standby.process.pid, restarts["standby"]))
        if self.tasks.process is not None:
            report.append(ProcessInfo("policy", self.tasks.process.pid, restarts["policy"]))
        for name, camera in self.cameras.processes.items():
            report.append(ProcessInfo(f"camera/{name}", camera.pid, restarts[f"camera/{name}"]))
        if self._instrument is not None and self._instrument.recorder_pid:
            report.append(ProcessInfo("recorder", self._instrument.recorder_pid, 0))
        if self.args.get("twin_pid"):
            report.append(ProcessInfo("twin", self.args["twin_pid"], 0))
        cameras = [f"camera/{name}" for name in self.cameras.processes]
        actors: dict[str, tuple[ActorInfo, ...]] = dict.fromkeys(
            ("root", "wire", "policy", "standby", *cameras), ()
        )

        async def ask(process: str) -> None:
            ref: Ref = self.node.ref(f"strands/{self.actors.introspection(process)}", Introspector)
            with contextlib.suppress(AskTimeout, Unreachable):
                introspection = await ref.ask(Describe(), 0.1)
                if isinstance(introspection, Introspection):
                    actors[process] = introspection.actors

        # Ask all processes at the same time, so that the answer does not wait for one frozen process after the
        # other.
        async with trio.open_nursery() as nursery:
            for process in actors:
                nursery.start_soon(ask, process)
        hosted = tuple(itertools.chain.from_iterable(actors.values()))
        last_stop = self.guardian.last_report
        return TreeReport(self.robot, mode, state.epoch, tuple(report), hosted, last_stop, state.locked_by)


def _is_end_of_task(error: BaseException) -> bool:
    """Return True if every exception in the group means the usual end of a task."""
    ends = (trio.Cancelled, GeneratorExit)
    if isinstance(error, BaseExceptionGroup):
        return error.split(ends)[1] is None
    return isinstance(error, ends)


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Run the root process."""
    take_name(args["robot"], "root", args["label"])
    hand_over()
    import_ours(args["driver"])
    read_protocols()  # read here, so that the forked children need not read them
    # Fork now, while this process has one thread and has not opened the robot's port.
    spawner = Spawner(
        close=(sock.fileno(), *args["descriptors"]),
        name=(args["robot"], "spawner", args["label"]),
        forget=args.clear,
    )
    raise_limits()  # after the fork of the spawner, which starts policies: they keep the limits of the user
    (page,) = args["descriptors"]
    robot, label = args["robot"], args["label"]
    wire = ForkedAhead((robot, "wire", label), (page,))
    standby = ForkedAhead((robot, "standby", label), session=True)
    ahead = Ahead(spawner, wire, standby, page)
    lower_oom_score()  # after the fork of the spawner, since its children (policies) would inherit the score
    trio.run(_main, args, sock, ahead)


async def _main(args: dict[str, Any], sock: socket.socket, ahead: Ahead) -> None:
    await Tree(args, ahead).run(sock)
