"""The controller's plain ports, without the SDK: a look before it is used, and the stop that does not need it.

The wire process looks and, when ur-rtde hangs, stops this way; the root does when the wire process is gone.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from typing import Any

import trio

from strands_actors.contract.driver import MotorReport, StopChannel, WireDown

from . import protocol as p
from .arms import JOINTS

CONNECT_S = 0.5
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

_CHUNK = 4096


@contextlib.asynccontextmanager
async def _connected(host: str, port: int) -> AsyncIterator[trio.SocketStream]:
    """Raise ``WireDown``. The close is an orderly one: a stop that a frozen controller has not read yet stays
    there for when it wakes up."""
    try:
        with trio.fail_after(CONNECT_S):
            stream = await trio.open_tcp_stream(host, port)
    except trio.TooSlowError:
        raise WireDown(f"{host}:{port}: no answer within {CONNECT_S:g} s. Check port=, network and power") from None
    except OSError as error:
        raise WireDown(f"{host}:{port}: cannot connect ({_words(error)}). Check port=, network and power") from None
    try:
        yield stream
    finally:
        with trio.CancelScope(shield=True):
            await trio.aclose_forcefully(stream)


def _words(error: BaseException) -> str:
    """Of the first attempt, where several addresses were tried."""
    while True:
        if isinstance(error, BaseExceptionGroup):
            error = error.exceptions[0]
        elif error.__cause__ is not None:
            error = error.__cause__
        else:
            return getattr(error, "strerror", None) or str(error)


async def _receive(stream: trio.SocketStream, name: str) -> bytes:
    try:
        with trio.fail_after(ANSWER_S):
            data = await stream.receive_some(_CHUNK)
    except trio.TooSlowError:
        raise WireDown(f"{name}: does not answer for {ANSWER_S * 1e3:g} ms. Is the controller alive?") from None
    except trio.BrokenResourceError:
        data = b""
    if not data:
        raise WireDown(f"{name}: the controller closed the connection")
    return bytes(data)


async def _send(stream: trio.SocketStream, data: bytes, name: str) -> None:
    try:
        with trio.fail_after(ANSWER_S):
            await stream.send_all(data)
    except (trio.TooSlowError, trio.BrokenResourceError):
        raise WireDown(f"{name}: the controller takes nothing") from None


# -- the dashboard


async def ask_dashboard(host: str, *lines: str) -> list[str]:
    """The answer to each line. Raise ``WireDown``."""
    name = f"{host}:{p.DASHBOARD_PORT}"
    answers: list[str] = []
    async with _connected(host, p.DASHBOARD_PORT) as stream:
        pending = b""
        for line in (None, *lines):  # the banner comes unasked
            if line is not None:
                await _send(stream, f"{line}\n".encode(), name)
            while b"\n" not in pending:
                pending += await _receive(stream, name)
            answer, _, pending = pending.partition(b"\n")
            if line is not None:
                answers.append(answer.decode("utf-8", "replace").strip())
    return answers


async def handshake(host: str) -> dict[str, Any]:
    """Who it is, for ``status``. Raise ``WireDown``."""
    version, serial, model, remote = await ask_dashboard(
        host, "PolyscopeVersion", "get serial number", "get robot model", "is in remote control"
    )
    return {"polyscope": version, "serial": serial, "robot_model": model, "remote_control": remote}


# -- samples


class Samples:
    """A stream of RTDE samples of ``LOOK``."""

    def __init__(self, stream: trio.SocketStream, host: str) -> None:
        self._stream = stream
        self._name = f"{host}:{p.RTDE_PORT}"
        self._decoder = p.Decoder()
        self._waiting: list[p.Packet] = []
        self._recipe: p.Recipe

    async def start(self) -> None:
        if await self._request(p.version_request(), p.Kind.VERSION) != b"\x01":
            raise WireDown(f"{self._name}: speaks no RTDE version {p.RTDE_VERSION}. Update its software")
        answer = await self._request(p.outputs_request(LOOK_HZ, LOOK), p.Kind.OUTPUTS)
        try:
            self._recipe = p.outputs_answer(answer, LOOK)
        except p.Garbled as error:
            raise WireDown(f"{self._name}: {error}") from None
        await self._request(p.frame(p.Kind.START), p.Kind.START)

    async def next(self) -> dict[str, Any]:
        """Raise ``WireDown`` when none comes."""
        try:
            return self._recipe.unpack(await self._packet(p.Kind.DATA))
        except p.Garbled as error:
            raise WireDown(f"{self._name}: {error}") from None

    async def _request(self, request: bytes, kind: int) -> bytes:
        await _send(self._stream, request, self._name)
        return await self._packet(kind)

    async def _packet(self, kind: int) -> bytes:
        while True:
            while self._waiting:
                packet = self._waiting.pop(0)
                if packet.kind == kind:
                    return packet.payload
            try:
                self._waiting.extend(self._decoder.feed(await _receive(self._stream, self._name)))
            except p.Garbled as error:
                raise WireDown(f"{self._name}: {error}") from None


@contextlib.asynccontextmanager
async def samples(host: str) -> AsyncIterator[Samples]:
    """Raise ``WireDown``."""
    async with _connected(host, p.RTDE_PORT) as stream:
        started = Samples(stream, host)
        await started.start()
        yield started


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


class _Stop:
    """What is known of a stop so far."""

    def __init__(self) -> None:
        self.written = False
        self.acknowledged = False  # the dashboard said so: a script port answers nothing
        self.ordered = False  # it had the time to take effect
        self.playing = True
        self.moving: list[int] = list(range(len(JOINTS)))  # or not known to stand
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


async def stop(host: str) -> tuple[MotorReport, ...]:
    """End whatever program runs, by the dashboard or, where that does not answer, by a script that replaces it;
    then see the arm stand. Never raises."""
    state = _Stop()
    with trio.move_on_after(STOP_S):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(_order, host, state)
            await _watch(host, state)
            if state.ordered:
                nursery.cancel_scope.cancel()
    return state.reports()


async def _order(host: str, state: _Stop) -> None:
    try:
        with trio.fail_after(DASHBOARD_S):
            await _stop_by_dashboard(host, state)
    except (WireDown, trio.TooSlowError) as failure:
        state.trouble.append(str(failure) or f"{host}:{p.DASHBOARD_PORT}: does not answer")
        try:
            await _stop_by_script(host, state)
        except WireDown as down:
            state.trouble.append(str(down))


async def _stop_by_dashboard(host: str, state: _Stop) -> None:
    name = f"{host}:{p.DASHBOARD_PORT}"
    async with _connected(host, p.DASHBOARD_PORT) as stream:
        await _send(stream, f"{p.DASHBOARD_STOP}\n".encode(), name)  # not after the banner: it may never come
        state.written = True
        said = b""
        while p.DASHBOARD_STOPPED.encode() not in said:
            said += await _receive(stream, name)
        state.acknowledged = state.ordered = True


async def _stop_by_script(host: str, state: _Stop) -> None:
    async with _connected(host, p.SECONDARY_PORT) as stream:
        await _send(stream, p.STOP_SCRIPT, f"{host}:{p.SECONDARY_PORT}")
        state.written = True
        await trio.sleep(SCRIPT_S)  # closed at once, what was sent might be dropped unread
        state.ordered = True


async def _watch(host: str, state: _Stop) -> None:
    """Until a sample that came after the order shows what was ordered. One that repeats the controller's time
    shows nothing."""
    time_s = -1.0
    try:
        async with samples(host) as stream:
            while state.playing or state.moving or not state.ordered:
                sample = await stream.next()
                time_s, before_s = sample["timestamp"], time_s
                if before_s in (-1.0, time_s):
                    continue
                state.playing = sample["runtime_state"] != p.RuntimeState.STOPPED
                state.moving = [at for at, rad_s in enumerate(sample["actual_qd"]) if abs(rad_s) >= STANDING_RAD_S]
    except WireDown as down:
        state.trouble.append(str(down))


class PlainPath(StopChannel):
    """The root's way: sockets of its own, opened when they are needed."""

    def __init__(self, host: str) -> None:
        self._host = host

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        return await stop(self._host)

    def close(self) -> None:
        """Nothing is kept open."""
