"""Drive a Reachy Mini through its daemon. This module runs in the wire process.

States and stops use one WebSocket, the events of moves another, and commands an HTTP connection.

A command is sent only after the previous one has been answered. If an answer takes more than half a second, the
link ends. No stop is confirmed while an answer is outstanding, because that request may still take effect. This
includes services that move the robot or switch its motors. The daemon ignores a target or a second move while a
move runs. Each command therefore first ends the move of the previous one.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from contextlib import aclosing
from typing import Any, ClassVar

import trio

from strands_actors.contract.rotations import roll_pitch_yaw
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, Wire, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.ports.http_port import HttpPort
from strands_actors.drivers.common.ports.websocket import WebSocket, open_websocket
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused

from . import protocol as p
from .config import ReachyConfig, publish_address
from .services import Moves, Services
from .stop import STOP_S, Stopper, send_at_once, stop_all_addresses

STATUS_S = 10.0
"""Timeout for the daemon's status."""

FIRST_S = 2.0
"""Timeout for the first position."""

COMMAND_S = 0.5
"""Timeout for the answer to a command, after which the link counts as lost."""

WAIT_S = 0.2
"""How long a command waits for the answer to the previous one."""

LOOK_S = 0.1
"""Period of the queries for the motors' mode and the running moves, which the stream of positions lacks."""

UNANSWERED_S = 0.03
"""How long a stop waits for the answer to a command that was just sent. On a connection that is open the stop
could overtake that command. After this time the stop is sent on a new connection, which the daemon reads after
those that wait."""

CUT_OFF_S = 0.1
"""After this time without a new connection, a stop is sent on the open WebSocket, too. The system of a frozen
daemon accepts connections within milliseconds. So this daemon is not frozen, but its answers are cut off."""

BATTERY_S = 5.0
"""How long a battery reading is valid. The daemon sends its status once per second."""

IGNORED_S = 0.5
"""How long an ignored command prevents further ones."""


class ReachyWire(Wire):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: ReachyConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._address = "", 0  # address of the daemon that was found
        self._address_descriptor: int | None = None  # descriptor of memory with the same address, for the root
        self._sdk: WebSocket | None = None
        self._updates: WebSocket | None = None
        self._commands: HttpPort | None = None
        self._nursery: trio.Nursery | None = None  # the task group of ``serve``; None before
        self._moves = Moves()
        self._services: Services | None = None
        # Set when the outstanding command is answered; None if no answer is outstanding.
        self._unanswered: trio.Event | None = None
        self._command_abandoned = False  # True if an answer to a command did not arrive in time
        self._joints: p.Joints | None = None
        self._head: p.Head | None = None
        self._head_ns = self._joints_ns = self._ignored_ns = 0
        self._foreign_move = False  # whether another client's move runs
        self._mode = math.nan
        self._mode_ns = 0
        self._imu: p.Imu | None = None
        self._battery_pct = math.nan
        self._imu_ns = self._battery_ns = 0
        self._problem = "no state has arrived yet"

    async def open(self) -> dict[str, Any]:
        self.close()
        status = await self._find()
        self._sdk = await open_websocket(*self._address, p.SDK, within_s=FIRST_S)
        self._updates = await open_websocket(*self._address, p.UPDATES, within_s=FIRST_S)
        with trio.move_on_after(FIRST_S):
            while self._head is None or self._joints is None:
                self._process(await self._sdk.receive())
        self._battery_pct, self._battery_ns = status.battery_pct, self._clock.now_ns()
        self._address_descriptor = publish_address(*self._address)
        return {
            "service": self._url,
            "daemon_version": status.version,
            "name": status.name,
            "hardware": "Wireless" if status.wireless else "Lite",
            "simulated": status.simulated,
        }

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        sdk, updates = self._sdk, self._updates
        if sdk is None or updates is None:
            raise WireDown("serve: not connected. Connect first")
        self._services = Services(self._config, *self._address, self._moves)
        modes = HttpPort(*self._address)
        commands = self._commands = HttpPort(*self._address)
        try:
            await self._look(modes)
            async with trio.open_nursery() as nursery:
                self._nursery = nursery
                await nursery.start(commands.serve)
                nursery.start_soon(self._receive_states, sdk)
                nursery.start_soon(self._follow_moves, updates)
                task_status.started()
                async with aclosing(self._clock.ticks(LOOK_S)) as ticks:
                    async for _ in ticks:
                        await self._look(modes)
        finally:
            self._nursery = None
            modes.close()

    async def arm(self, permit: Permit) -> Observation:
        """Return the present state and accept commands from now on. Arming gives no torque and moves nothing."""
        permit.check()
        return await self.read()

    async def read(self) -> Observation:
        await trio.lowlevel.checkpoint()
        if self._services is not None and self._services.abandoned:
            raise WireDown(f"read: the daemon did not answer a request: {self._services.abandoned}")
        head, joints, now_ns = self._head, self._joints, self._clock.now_ns()
        oldest_ns = min(self._head_ns, self._joints_ns)
        silent_ns = round(self._config.silent_s * NS)
        if head is None or joints is None or now_ns - oldest_ns > silent_ns:
            raise WireDown(
                f"read: no state from the daemon for {self._config.silent_s:g} s ({self._problem}). "
                "Check the daemon"
            )
        if now_ns - self._mode_ns > silent_ns:
            raise WireDown(
                f"read: the daemon no longer reports the motors' mode ({self._problem}). Check the daemon"
            )
        return Observation(
            t_ns=oldest_ns,
            position=p.row_of(head, joints),
            stamp_ns=(self._head_ns,) * p.BODY + (self._joints_ns,) * (len(self._config.axes) - p.BODY),
            sensors={
                **self._felt(now_ns),
                "motor_mode": (self._mode,),
                "ignored": (float(now_ns - self._ignored_ns < IGNORED_S * NS),),
                "others_move": (float(self._foreign_move),),
                "head_xyz_m": head.xyz_m,
                "head_rpy_rad": head.rpy_rad,
            },
        )

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        nursery, port = self._nursery, self._commands
        if nursery is None or port is None or self._abandoned:
            raise WireDown("write: not connected, or an answer is missing. Reconnect")
        if not await self._answered(WAIT_S):
            raise PermitDenied("the previous command has not been answered")
        await port.ready()
        *target, duration_s = values
        permit.check()
        if self._moves.running:
            port.send("POST", p.STOP, p.encode_uuid(self._moves.running))
        if duration_s:
            number = port.send("POST", p.GOTO, p.encode_goto(target, duration_s))
        else:
            number = port.send("POST", p.SET_TARGET, p.encode_target(target))
        self._unanswered = trio.Event()
        nursery.start_soon(self._take_answer, port, number, self._unanswered, bool(duration_s))

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        self._send_at_once(safe_state)
        with trio.move_on_after(UNANSWERED_S):
            while (unanswered := self._pending()) is not None:
                await unanswered.wait()
        return await self._stop(safe_state)

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the robot after its link was lost, as ``make_safe`` does, but without waiting for an outstanding
        answer."""
        self._send_at_once(safe_state)
        return await self._stop(safe_state)

    def _send_at_once(self, safe_state: SafeState) -> None:
        """Send the first messages of a stop on the open connections, before any wait.

        If a command waits on a connection, only that one is used: a frozen daemon that continues reads its
        connections in any order, and the stop must be read after the command.
        """
        running = self._moves.running
        if not send_at_once(safe_state, (), self._unanswered_ports(), running):
            send_at_once(safe_state, (self._sdk,), (self._commands,), running)

    def _unanswered_ports(self) -> tuple[HttpPort, ...]:
        """Return the connections on which the daemon may not have read a command yet."""
        commands = self._commands if self._unanswered is not None else None
        unanswered_port = self._services.unanswered_port if self._services is not None else None
        return tuple(port for port in (commands, unanswered_port) if port is not None)

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        services = self._services
        if services is None:
            raise WireDown("not connected")
        if not await self._answered(WAIT_S):
            raise PermitDenied("the previous command has not been answered")
        return await services.perform(service, arguments, permit, await self.read())

    def handover(self) -> Sequence[int]:
        """Return the address of the daemon that was found, as a file descriptor for the root. Other possible
        addresses may belong to another robot."""
        return () if self._address_descriptor is None else (self._address_descriptor,)

    def close(self) -> None:
        if self._address_descriptor is not None:
            os.close(self._address_descriptor)
            self._address_descriptor = None
        for socket in (self._sdk, self._updates):
            if socket is not None:
                socket.close()
        if self._commands is not None:
            self._commands.close()
        self._sdk = self._updates = self._commands = self._services = None
        self._unanswered = self._head = self._joints = None

    # -- background tasks

    async def _receive_states(self, sdk: WebSocket) -> None:
        while True:
            self._process(await sdk.receive())

    def _process(self, message: str | bytes) -> None:
        try:
            match p.decode_sdk(message):
                case p.Joints() as joints:
                    self._joints, self._joints_ns = joints, self._clock.now_ns()
                case p.Head() as head:
                    self._head, self._head_ns = head, self._clock.now_ns()
                case p.Imu() as imu:
                    self._imu, self._imu_ns = imu, self._clock.now_ns()
                case p.Status() as status:
                    self._battery_pct, self._battery_ns = status.battery_pct, self._clock.now_ns()
        except MalformedFrame as malformed:
            # A single unreadable message is ignored. ``read`` reports the problem if it persists.
            self._problem = str(malformed)

    def _felt(self, now_ns: int) -> dict[str, tuple[float, ...]]:
        """Return the recent readings of the IMU and the battery. A missing or old reading is left out."""
        felt: dict[str, tuple[float, ...]] = {}
        if not math.isnan(self._battery_pct) and now_ns - self._battery_ns <= BATTERY_S * NS:
            felt["battery_pct"] = (self._battery_pct,)
        imu = self._imu
        if imu is not None and now_ns - self._imu_ns <= self._config.silent_s * NS:
            felt["accelerometer_m_s2"] = imu.accelerometer_m_s2
            felt["gyroscope_rad_s"] = imu.gyroscope_rad_s
            felt["quaternion_wxyz"] = imu.quaternion_wxyz
            felt["imu_rpy_rad"] = roll_pitch_yaw(imu.quaternion_wxyz)
            felt["imu_temperature_c"] = (imu.temperature_c,)
        return felt

    async def _follow_moves(self, updates: WebSocket) -> None:
        while True:
            message = await updates.receive()
            try:
                self._moves.process(p.decode_update(message))
            except MalformedFrame as malformed:
                self._problem = str(malformed)

    async def _look(self, modes: HttpPort) -> None:
        """Request the motors' mode, and find out whether another client's move runs."""
        try:
            answer = await modes.ask("GET", p.MOTORS, within_s=COMMAND_S)
            if answer.status != p.OK:
                raise MalformedFrame(f"{p.MOTORS}: status {answer.status}")
            self._mode, self._mode_ns = float(p.decode_mode(answer.body)), self._clock.now_ns()
            answer = await modes.ask("GET", p.RUNNING, within_s=COMMAND_S)
            if answer.status != p.OK:
                raise MalformedFrame(f"{p.RUNNING}: status {answer.status}")
            running = p.decode_running(answer.body)
            # While a command of ours is unanswered, an unknown move in the list may be its move.
            if self._pending() is None:
                self._foreign_move = self._moves.has_foreign(running)
        except (WireDown, MalformedFrame) as problem:
            self._problem = str(problem)

    async def _take_answer(self, port: HttpPort, number: int, unanswered: trio.Event, is_move: bool) -> None:
        """Wait for the answer to a command. Raise ``WireDown`` if it does not arrive in time."""
        answered, uuid = False, ""
        try:
            with trio.move_on_after(COMMAND_S):
                answer = await port.answer(number, math.inf)
                answered = True
                if answer.status != p.OK:
                    raise WireDown(f"write: the daemon answered with status {answer.status}. Check the daemon")
                try:
                    if is_move:
                        uuid = p.decode_move(answer.body)
                        self._moves.begin(uuid)
                    elif not p.decode_target_answer(answer.body):
                        self._ignored_ns = self._clock.now_ns()
                except MalformedFrame as malformed:
                    raise WireDown(
                        f"write: the daemon sent an invalid answer: {malformed}. Check the daemon"
                    ) from None
            if not answered:
                raise WireDown(f"write: no answer of the daemon within {COMMAND_S * 1e3:.0f} ms. Check the daemon")
        finally:
            if answered:
                self._unanswered = None
                unanswered.set()
            else:
                self._command_abandoned = True
        if uuid and await self._moves.ignored(uuid):
            self._ignored_ns = self._clock.now_ns()

    @property
    def _abandoned(self) -> bool:
        """Return True if an answer has not arrived in time. No more commands are sent then."""
        return self._command_abandoned or (self._services is not None and bool(self._services.abandoned))

    async def _answered(self, within_s: float) -> bool:
        """Wait until no answer to a command is outstanding. Return False after ``within_s`` seconds."""
        with trio.move_on_after(within_s):
            while self._unanswered is not None:
                await self._unanswered.wait()
        return self._unanswered is None

    def _pending(self) -> trio.Event | None:
        """Return an event that is set when the outstanding request is answered; None if no request is
        outstanding."""
        if self._services is not None and self._services.unanswered is not None:
            return self._services.unanswered
        return None if self._command_abandoned else self._unanswered

    async def _stop(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop on the open connection. If a command may wait on another connection, use a new connection,
        because the daemon could read the stop before that command.

        If no new connection can be opened either, only the answers of the daemon may be cut off. So the stop is
        then sent on the open connection, too.

        If the daemon confirms the stop while a command is still not answered, the connection of the command is
        reset, which drops it. The command may already be on its way, so the robot is then stopped once more.
        """
        if not self._address[0]:
            return await stop_all_addresses(self._config, safe_state)
        socket = self._sdk if self._pending() is None and not self._abandoned else None
        stopper = Stopper(*self._address, socket, lambda: self._nursery is not None, lambda: self._moves.running)
        try:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self._send_if_cut_off, stopper, safe_state)
                detail = await stopper.run(safe_state, STOP_S, lambda: self._pending() is not None)
                nursery.cancel_scope.cancel()
            if not detail and (unanswered := self._unanswered_ports()):
                for port in unanswered:
                    port.reset()
                self._unanswered = None
                detail = await stopper.run(safe_state, STOP_S)
        finally:
            stopper.close()
        outcome = Outcome(stopper.written, stopper.acknowledged, detail)
        return outcome.reports(self._config.axes, self._config.ids)

    async def _send_if_cut_off(self, stopper: Stopper, safe_state: SafeState) -> None:
        await trio.sleep(CUT_OFF_S)
        if not stopper.written:
            stopper.written = send_at_once(safe_state, (self._sdk,), ())

    # -- the daemon

    @property
    def _url(self) -> str:
        host, number = self._address
        return f"http://[{host}]:{number}" if ":" in host else f"http://{host}:{number}"

    async def _find(self) -> p.Status:
        """Return the status of the first daemon that answers, and store its address. Raise ``WireDown``."""
        try:
            addresses = self._config.addresses()
        except ValueError as error:
            raise WireDown(str(error)) from None
        problems: list[str] = []
        for host, number in addresses:
            port = HttpPort(host, number)
            try:
                answer = await port.ask("GET", p.STATUS, within_s=STATUS_S / len(addresses))
                if answer.status != p.OK:
                    raise MalformedFrame(f"status {answer.status}")
                status = p.decode_status(answer.body)
            except WireDown as down:
                problems.append(str(down))
                continue
            except MalformedFrame as malformed:
                problems.append(f"{port.name}: GET {p.STATUS}: {malformed}. Check that the daemon runs there")
                continue
            finally:
                port.close()
            if status.state != "running" or status.error:
                problem = f" ({status.error})" if status.error else ""
                raise WireDown(f"{port.name}: the daemon is {status.state}{problem}. Start it, or look at its log")
            self._address = host, number
            return status
        raise WireDown("; ".join(problems))
