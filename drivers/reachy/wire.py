"""Connect the wire process to the daemon of a Reachy Mini.

State and stops use one WebSocket, the events of moves another, and commands an HTTP connection.

A command is written after the previous one has been answered. One that is not answered within half a second
ends the link. No stop is confirmed while an answer is outstanding, because the request may still take effect.
This includes services that move the robot or switch its motors. The daemon ignores a target or a second move
while a move runs, so each command first ends the move of the previous one.
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

OWED_S = 0.03
"""How long a stop waits for the answer to a command that was just sent. On a connection that is open the stop
could overtake that command. After this time the stop is sent on a new connection, which the daemon reads after
those that wait."""

BATTERY_S = 5.0
"""How long a battery reading is valid. The daemon sends its status once per second."""

IGNORED_S = 0.5
"""How long an ignored command prevents further ones."""


class ReachyWire(Wire):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: ReachyConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._where = "", 0  # address of the daemon that was found
        self._told: int | None = None  # the same address, as a descriptor
        self._sdk: WebSocket | None = None
        self._updates: WebSocket | None = None
        self._commands: HttpPort | None = None
        self._nursery: trio.Nursery | None = None  # of ``serve``
        self._moves = Moves()
        self._services: Services | None = None
        # Set when the outstanding command is answered; None without one.
        self._owed: trio.Event | None = None
        self._gave_up = False  # whether the answer to a command did not arrive in time
        self._joints: p.Joints | None = None
        self._head: p.Head | None = None
        self._head_ns = self._joints_ns = self._ignored_ns = 0
        self._others = False  # whether a move of another client runs
        self._mode = math.nan
        self._mode_ns = 0
        self._imu: p.Imu | None = None
        self._battery_pct = math.nan
        self._imu_ns = self._battery_ns = 0
        self._problem = "it has told nothing yet"

    async def open(self) -> dict[str, Any]:
        self.close()
        status = await self._find()
        self._sdk = await open_websocket(*self._where, p.SDK, within_s=FIRST_S)
        self._updates = await open_websocket(*self._where, p.UPDATES, within_s=FIRST_S)
        with trio.move_on_after(FIRST_S):
            while self._head is None or self._joints is None:
                self._hear(await self._sdk.receive())
        self._battery_pct, self._battery_ns = status.battery_pct, self._clock.now_ns()
        self._told = publish_address(*self._where)
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
            raise WireDown("serve: not connected. Open it first")
        self._services = Services(self._config, *self._where, self._moves)
        modes = HttpPort(*self._where)
        commands = self._commands = HttpPort(*self._where)
        try:
            await self._look(modes)
            async with trio.open_nursery() as nursery:
                self._nursery = nursery
                await nursery.start(commands.serve)
                nursery.start_soon(self._hear_all, sdk)
                nursery.start_soon(self._follow_moves, updates)
                task_status.started()
                async with aclosing(self._clock.ticks(LOOK_S)) as ticks:
                    async for _ in ticks:
                        await self._look(modes)
        finally:
            self._nursery = None
            modes.close()

    async def arm(self, permit: Permit) -> Observation:
        """Return the present state. Arming gives no torque and moves nothing."""
        permit.check()
        return await self.read()

    async def read(self) -> Observation:
        await trio.lowlevel.checkpoint()
        if self._services is not None and self._services.given_up:
            raise WireDown(f"read: a service was not answered: {self._services.given_up}")
        head, joints, now_ns = self._head, self._joints, self._clock.now_ns()
        seen_ns = min(self._head_ns, self._joints_ns)
        silent_ns = round(self._config.silent_s * NS)
        if head is None or joints is None or now_ns - seen_ns > silent_ns:
            raise WireDown(
                f"read: no daemon frame for {self._config.silent_s:g} s ({self._problem}). Check the daemon"
            )
        if now_ns - self._mode_ns > silent_ns:
            raise WireDown(f"read: the motors' mode is not told any more ({self._problem}). Check the daemon")
        return Observation(
            t_ns=seen_ns,
            position=p.row_of(head, joints),
            stamp_ns=(self._head_ns,) * p.BODY + (self._joints_ns,) * (len(self._config.axes) - p.BODY),
            sensors={
                **self._felt(now_ns),
                "motor_mode": (self._mode,),
                "ignored": (float(now_ns - self._ignored_ns < IGNORED_S * NS),),
                "others_move": (float(self._others),),
                "head_xyz_m": head.xyz_m,
                "head_rpy_rad": head.rpy_rad,
            },
        )

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        nursery, port = self._nursery, self._commands
        if nursery is None or port is None or self._given_up:
            raise WireDown("write: not connected, or no answer. Open it anew")
        if not await self._answered(WAIT_S):
            raise PermitDenied("the command before has not been answered")
        await port.ready()
        *target, duration_s = values
        permit.check()
        if self._moves.running:
            port.send("POST", p.STOP, p.encode_uuid(self._moves.running))
        if duration_s:
            number = port.send("POST", p.GOTO, p.encode_goto(target, duration_s))
        else:
            number = port.send("POST", p.SET_TARGET, p.encode_target(target))
        self._owed = trio.Event()
        nursery.start_soon(self._take_answer, port, number, self._owed, bool(duration_s))

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        self._send_at_once(safe_state)
        with trio.move_on_after(OWED_S):
            while (owed := self._pending()) is not None:
                await owed.wait()
        return await self._stop(safe_state)

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the robot as ``make_safe``, but without waiting for an outstanding answer."""
        self._send_at_once(safe_state)
        return await self._stop(safe_state)

    def _send_at_once(self, safe_state: SafeState) -> None:
        """Send the first frames on the open connections, before any wait.

        If a command waits on a connection, only that one is used: a frozen daemon that continues reads its
        connections in any order, and the stop must be read after the command.
        """
        running = self._moves.running
        if not send_at_once(safe_state, (), self._waits_on(), running):
            send_at_once(safe_state, (self._sdk,), (self._commands,), running)

    def _waits_on(self) -> tuple[HttpPort, ...]:
        """Return the connections on which a command may still wait to be read."""
        commands = self._commands if self._owed is not None else None
        asks_on = self._services.asks_on if self._services is not None else None
        return tuple(port for port in (commands, asks_on) if port is not None)

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        services = self._services
        if services is None:
            raise WireDown("not connected")
        if not await self._answered(WAIT_S):
            raise PermitDenied("the command before has not been answered")
        return await services.perform(service, arguments, permit, await self.read())

    def handover(self) -> Sequence[int]:
        """Return the address of the daemon that was found, for the root: other addresses may have another
        robot."""
        return () if self._told is None else (self._told,)

    def close(self) -> None:
        if self._told is not None:
            os.close(self._told)
            self._told = None
        for socket in (self._sdk, self._updates):
            if socket is not None:
                socket.close()
        if self._commands is not None:
            self._commands.close()
        self._sdk = self._updates = self._commands = self._services = None
        self._owed = self._head = self._joints = None

    # -- background tasks

    async def _hear_all(self, sdk: WebSocket) -> None:
        while True:
            self._hear(await sdk.receive())

    def _hear(self, message: str | bytes) -> None:
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
            self._problem = str(malformed)  # ``read`` reports it if it persists.

    def _felt(self, now_ns: int) -> dict[str, tuple[float, ...]]:
        """Return the recent readings of IMU and battery. A reading that is missing or old is left out."""
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
                self._moves.hear(p.decode_update(message))
            except MalformedFrame as malformed:
                self._problem = str(malformed)

    async def _look(self, modes: HttpPort) -> None:
        """Query the motors' mode, and whether a move of another client runs."""
        try:
            answer = await modes.ask("GET", p.MOTORS, within_s=COMMAND_S)
            if answer.status != p.OK:
                raise MalformedFrame(f"{p.MOTORS}: status {answer.status}")
            self._mode, self._mode_ns = float(p.decode_mode(answer.body)), self._clock.now_ns()
            answer = await modes.ask("GET", p.RUNNING, within_s=COMMAND_S)
            if answer.status != p.OK:
                raise MalformedFrame(f"{p.RUNNING}: status {answer.status}")
            running = p.decode_running(answer.body)
            # While our command is unanswered, an unknown move in the list may be ours.
            if self._pending() is None:
                self._others = self._moves.others(running)
        except (WireDown, MalformedFrame) as problem:
            self._problem = str(problem)

    async def _take_answer(self, port: HttpPort, number: int, owed: trio.Event, is_move: bool) -> None:
        """Take the answer to a command. Raise ``WireDown`` if it does not arrive in time."""
        answered, uuid = False, ""
        try:
            with trio.move_on_after(COMMAND_S):
                answer = await port.answer(number, math.inf)
                answered = True
                if answer.status != p.OK:
                    raise WireDown(f"write: the answer is status {answer.status}. Look at the daemon")
                try:
                    if is_move:
                        uuid = p.decode_move(answer.body)
                        self._moves.begin(uuid)
                    elif not p.decode_target_answer(answer.body):
                        self._ignored_ns = self._clock.now_ns()
                except MalformedFrame as malformed:
                    raise WireDown(f"write: {malformed}. Look at the daemon") from None
            if not answered:
                raise WireDown(f"write: no answer within {COMMAND_S * 1e3:.0f} ms. Check the daemon")
        finally:
            if answered:
                self._owed = None
                owed.set()
            else:
                self._gave_up = True
        if uuid and await self._moves.ignored(uuid):
            self._ignored_ns = self._clock.now_ns()

    @property
    def _given_up(self) -> bool:
        """Whether an answer did not arrive in time. This wire then writes no more commands."""
        return self._gave_up or (self._services is not None and bool(self._services.given_up))

    async def _answered(self, within_s: float) -> bool:
        """Wait until no answer to a command is outstanding. Return whether that is so."""
        with trio.move_on_after(within_s):
            while self._owed is not None:
                await self._owed.wait()
        return self._owed is None

    def _pending(self) -> trio.Event | None:
        """Return an event that is set when the outstanding request is answered; None without such a request."""
        if self._services is not None and self._services.owed is not None:
            return self._services.owed
        return None if self._gave_up else self._owed

    async def _stop(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop on the open connection, unless a command may wait on another one. The daemon could then read the
        stop before that command, so a new connection is used."""
        if not self._where[0]:
            return await stop_all_addresses(self._config, safe_state)
        socket = self._sdk if self._pending() is None and not self._given_up else None
        stopper = Stopper(*self._where, socket, lambda: self._nursery is not None, lambda: self._moves.running)
        try:
            detail = await stopper.run(safe_state, STOP_S, lambda: self._pending() is not None)
        finally:
            stopper.close()
        outcome = Outcome(stopper.written, stopper.acknowledged, detail)
        return outcome.reports(self._config.axes, self._config.ids)

    # -- the daemon

    @property
    def _url(self) -> str:
        host, number = self._where
        return f"http://[{host}]:{number}" if ":" in host else f"http://{host}:{number}"

    async def _find(self) -> p.Status:
        """Return the status of the first daemon that answers, and note its address. Raise ``WireDown``."""
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
                problems.append(f"{port.name}: GET {p.STATUS}: {malformed}. Check what is served there")
                continue
            finally:
                port.close()
            if status.state != "running" or status.error:
                why = f" ({status.error})" if status.error else ""
                raise WireDown(f"{port.name}: the daemon is {status.state}{why}. Start it, or look at its log")
            self._where = host, number
            return status
        raise WireDown("; ".join(problems))
