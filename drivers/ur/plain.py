"""The controller's plain ports, without the SDK: a look before it is used, and the stop that does not need it.

The wire process looks and, when ur-rtde hangs, stops this way; the root does when the wire process is gone.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Sequence
from typing import Any

import trio

from strands_actors.contract.driver import MotorReport, StopChannel, WireDown
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.tcp_port import TcpPort, open_tcp
from strands_actors.kernel.clock import Clock

from . import protocol as p
from .arms import JOINTS
from .config import URConfig

ANSWER_S = 0.5
"""A controller answers within milliseconds; it may be busy starting a program."""

STOP_S = 1.2
"""From top speed a joint needs 0.8 s at the deceleration of ``stopj``."""

DASHBOARD_S = 0.25
"""The dashboard is a program of its own on the controller, and may hang while the arm goes on."""

SCRIPT_S = 0.2
"""By then a program that was sent has replaced the one before [assumed]."""

STANDING_RAD_S = 0.02

LOOK = ("timestamp", "actual_q", "actual_qd", "robot_mode", "safety_mode", "runtime_state")
LOOK_HZ = 125.0


@contextlib.asynccontextmanager
async def _connected(host: str, port: int) -> AsyncIterator[TcpPort]:
    """Raise ``WireDown``. The close is an orderly one: a stop that a frozen controller has not read yet stays
    there for when it wakes up."""
    stream = await open_tcp(host, port)
    try:
        yield stream
    finally:
        stream.close_in_order()


async def _receive(stream: TcpPort) -> bytes:
    with trio.move_on_after(ANSWER_S):
        return await stream.read()
    raise WireDown(f"{stream.name}: does not answer for {ANSWER_S * 1e3:g} ms. Is the controller alive?")


# -- the dashboard


async def ask_dashboard(host: str, *lines: str) -> list[str]:
    """Return the answer to each line. Raise ``WireDown``."""
    answers: list[str] = []
    async with _connected(host, p.DASHBOARD_PORT) as stream:
        pending = b""
        for line in ("", *lines):  # the banner comes unasked
            if line:
                stream.write(f"{line}\n".encode())
            while b"\n" not in pending:
                pending += await _receive(stream)
            answer, _, pending = pending.partition(b"\n")
            answers.append(answer.decode("utf-8", "replace").strip())
    return answers[1:]


async def handshake(host: str) -> dict[str, Any]:
    """Return who it is, for ``status``. Raise ``WireDown``."""
    version, serial, model, remote = await ask_dashboard(
        host, "PolyscopeVersion", "get serial number", "get robot model", "is in remote control"
    )
    return {"polyscope": version, "serial": serial, "robot_model": model, "remote_control": remote}


# -- samples


class Samples:
    """A stream of RTDE samples of ``LOOK``."""

    def __init__(self, stream: TcpPort) -> None:
        self._stream = stream
        self._decoder = p.Decoder()
        self._waiting: list[p.Packet] = []
        self._recipe: p.Recipe

    async def start(self) -> None:
        if await self._request(p.version_request(), p.Kind.VERSION) != b"\x01":
            raise WireDown(f"{self._stream.name}: speaks no RTDE version {p.RTDE_VERSION}. Update its software")
        self._recipe = p.outputs_answer(await self._request(p.outputs_request(LOOK_HZ, LOOK), p.Kind.OUTPUTS), LOOK)
        await self._request(p.frame(p.Kind.START), p.Kind.START)

    async def next(self) -> dict[str, Any]:
        """Raise ``WireDown`` when none comes."""
        return self._recipe.unpack(await self._packet(p.Kind.DATA))

    async def _request(self, request: bytes, kind: int) -> bytes:
        self._stream.write(request)
        return await self._packet(kind)

    async def _packet(self, kind: int) -> bytes:
        while True:
            while self._waiting:
                packet = self._waiting.pop(0)
                if packet.kind == kind:
                    return packet.payload
            self._waiting.extend(self._decoder.feed(await _receive(self._stream)))


@contextlib.asynccontextmanager
async def samples(host: str) -> AsyncIterator[Samples]:
    """Raise ``WireDown``, also for samples that cannot be read."""
    async with _connected(host, p.RTDE_PORT) as stream:
        started = Samples(stream)
        try:
            await started.start()
            yield started
        except MalformedFrame as malformed:
            raise WireDown(f"{stream.name}: {malformed}") from None


async def look(host: str) -> None:
    """See the controller's clock advance. Raise ``WireDown`` when it does not."""
    async with samples(host) as stream:
        first = await stream.next()
        with trio.move_on_after(ANSWER_S):
            while (await stream.next())["timestamp"] == first["timestamp"]:
                pass
            return
    raise WireDown(f"{host}: samples come, but the controller's clock stands still. Restart the controller")


# -- the stop


def unsafe(why: str) -> tuple[MotorReport, ...]:
    """Return that nothing was done to any joint."""
    return tuple(MotorReport(joint, at, False, False, False, why) for at, joint in enumerate(JOINTS))


class _Stop:
    """What is known of a stop so far."""

    def __init__(self, host: str) -> None:
        self._host = host
        self.written = False
        self.acknowledged = False  # the dashboard said so: a script port answers nothing
        self.ordered = False  # it had the time to take effect
        self.playing = True
        self.moving = set(range(len(JOINTS)))  # or not known to stand
        self.trouble: list[str] = []

    def reports(self) -> tuple[MotorReport, ...]:
        said = ", ".join(dict.fromkeys(self.trouble))
        reports = []
        for at, joint in enumerate(JOINTS):
            moves = at in self.moving
            safe = self.written and not self.playing and not moves
            detail = "" if safe else said or ("moves" if moves else "its program runs")
            reports.append(MotorReport(joint, at, self.written, self.acknowledged, safe, detail))
        return tuple(reports)

    async def order(self) -> None:
        """End what runs by the dashboard or, where that does not answer, by a script that replaces it."""
        try:
            with trio.fail_after(DASHBOARD_S):
                await self._by_dashboard()
        except (WireDown, trio.TooSlowError) as failure:
            self.trouble.append(str(failure) or f"{self._host}:{p.DASHBOARD_PORT}: does not answer")
            try:
                await self._by_script()
            except WireDown as down:
                self.trouble.append(str(down))

    async def _by_dashboard(self) -> None:
        async with _connected(self._host, p.DASHBOARD_PORT) as stream:
            stream.write(f"{p.DASHBOARD_STOP}\n".encode())  # not after the banner: it may never come
            self.written = True
            said = b""
            while p.DASHBOARD_STOPPED.encode() not in said:
                said += await _receive(stream)
            self.acknowledged = self.ordered = True

    async def _by_script(self) -> None:
        async with _connected(self._host, p.SECONDARY_PORT) as stream:
            stream.write(p.STOP_SCRIPT)
            self.written = True
            await trio.sleep(SCRIPT_S)  # closed at once, what was sent might be dropped unread
            self.ordered = True

    async def watch(self) -> None:
        """Wait for a sample that came after the order and shows what was ordered. One that repeats the
        controller's time shows nothing."""
        time_s = -1.0
        try:
            async with samples(self._host) as stream:
                while self.playing or self.moving or not self.ordered:
                    sample = await stream.next()
                    time_s, before_s = sample["timestamp"], time_s
                    if before_s in (-1.0, time_s):
                        continue
                    self.playing = sample["runtime_state"] != p.RuntimeState.STOPPED
                    self.moving = {
                        at for at, rad_s in enumerate(sample["actual_qd"]) if abs(rad_s) >= STANDING_RAD_S
                    }
        except WireDown as down:
            self.trouble.append(str(down))


async def stop(config: URConfig) -> tuple[MotorReport, ...]:
    """End whatever program runs, then see the arm stand. Never raises."""
    try:
        state = _Stop(config.host)
    except ValueError as error:
        return unsafe(str(error))
    with trio.move_on_after(STOP_S):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(state.order)
            await state.watch()
            if state.ordered:
                nursery.cancel_scope.cancel()
    return state.reports()


class URStopChannel(StopChannel):
    """The root's way: sockets of its own, opened when they are needed."""

    def __init__(self, config: URConfig, descriptors: Sequence[int], clock: Clock) -> None:
        self._config = config

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        return await stop(self._config)

    def close(self) -> None:
        """Nothing is kept open."""
