"""Rig of an arm that is commanded by an SDK and stopped without it: UR."""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import trio

from strands_actors.drivers.common.kit import sdk as sdk_calls
from strands_actors.drivers.common.twin import Faults
from strands_actors.drivers.ur import plain, sdk
from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.arms import arm_of
from strands_actors.drivers.ur.driver import UR
from strands_actors.drivers.ur.twin import commands as c
from strands_actors.drivers.ur.twin import state_packets
from strands_actors.drivers.ur.twin.control_script import ControlScript
from strands_actors.drivers.ur.twin.controller import TICK_HZ, Controller
from strands_actors.drivers.ur.twin.outputs import Sample
from strands_actors.drivers.ur.twin.rtde import RtdeServer
from strands_actors.drivers.ur.twin.script import run_text
from strands_actors.drivers.ur.twin.text_ports import Dashboard, ScriptPort

from .bench import Bench, Rig, Situation, first_joint
from .peer import HostilePeer
from .services import Service

THREAD_S = 0.002
"""Time from a call of the SDK until its thread carries it out."""
STATE_HZ = 10.0
SCRIPT = b"def rtde_control():\n    global reg_offset_int = # int register offset\n24\nend\n"


class _NeverReturns(Exception):
    """A call of the SDK does not return, because it waits for the robot."""


class _Sdk:
    """Write commands into registers, as ur-rtde does.

    Before a command it waits for the script's answer to the last one. If that answer is garbled, it writes
    nothing and does not return. This is the worst case.
    """

    def __init__(self, controller: Controller, peer: HostilePeer, service: Service) -> None:
        self._controller, self._peer, self._service = controller, peer, service
        self.gone = False
        peer.join(self)  # type: ignore[arg-type]  # of which it needs the end alone

    def wake(self) -> None:
        """Do nothing: the SDK polls."""

    def reuploadScript(self) -> bool:  # the SDK's names
        self._check()
        self._service.log.note(c.classify_script(SCRIPT))
        run_text(SCRIPT, self._controller)
        return True

    def isProgramRunning(self) -> bool:
        return isinstance(self._controller.program, ControlScript)

    def setWatchdog(self, min_hz: float) -> Coroutine[Any, Any, bool]:
        return self._wait_for(c.Command.SET_WATCHDOG, [min_hz])

    def kickWatchdog(self) -> bool:
        return self._send(c.Command.KICK_WATCHDOG)

    def servoJ(self, q: Sequence[float], *others: float) -> bool:
        return self._send(c.Command.SERVO_J, q)

    def servoStop(self, deceleration: float) -> Coroutine[Any, Any, bool]:
        return self._wait_for(c.Command.SERVO_STOP)

    def stopScript(self) -> Coroutine[Any, Any, bool]:
        return self._wait_for(c.Command.STOP_SCRIPT)

    def _check(self) -> None:
        if self.gone:
            raise RuntimeError("the connection is gone")

    def _send(self, command: int, values: Sequence[float] = ()) -> bool:
        if self._peer.kind not in ("", "flood"):
            raise _NeverReturns
        self._check()
        self._service.log.note(c.classify_command(command))
        doubles = {f"input_double_register_{c.UPPER_RANGE + at}": value for at, value in enumerate(values)}
        self._controller.write({**doubles, f"input_int_register_{c.UPPER_RANGE}": int(command)})
        return self.isProgramRunning()

    async def _wait_for(self, command: int, values: Sequence[float] = ()) -> bool:
        runs = self._send(command, values)
        while self.isProgramRunning() and self._controller.int_out[c.UPPER_RANGE] != c.DONE:
            self._check()
            await trio.sleep(THREAD_S)
        self._controller.write({f"input_int_register_{c.UPPER_RANGE}": int(c.Command.NONE)})
        return runs


async def _call_in_thread(function: Callable[..., Any], *args: Any) -> Any:
    await trio.sleep(THREAD_S)
    try:
        result = function(*args)
        return await result if inspect.isawaitable(result) else result
    except _NeverReturns:
        await trio.sleep_forever()


def _ur(peer: HostilePeer) -> Bench:
    controller = Controller(arm_of("ur5e"), now_s=trio.current_time)
    rtde = RtdeServer(controller, Faults())
    state = ScriptPort(controller, STATE_HZ, state_packets.state_message, state_packets.version_message())
    service = Service(
        peer,
        {
            p.RTDE_PORT: rtde.handle,
            p.DASHBOARD_PORT: Dashboard(controller, "ur5e").handle,
            p.SECONDARY_PORT: state.handle,
        },
    )

    def load_sdk(module: str, install: str) -> Any:
        opened = lambda *args: _Sdk(controller, peer, service)  # noqa: E731
        opened.FLAG_UPPER_RANGE_REGISTERS = opened.FLAG_NO_WAIT = 0  # type: ignore[attr-defined]
        return SimpleNamespace(RTDEControlInterface=opened)

    async def live() -> None:
        ticks = 0
        while True:
            await trio.sleep(1 / TICK_HZ)
            ticks += 1
            controller.tick()
            sample = cache(partial(Sample, controller))
            rtde.push(ticks, trio.current_time(), sample)
            state.push(ticks, sample)

    @contextlib.asynccontextmanager
    async def living() -> AsyncIterator[None]:
        places = [
            (plain, "open_tcp", service.open_stream),
            (sdk, "load_sdk", load_sdk),
            (sdk, "kept", lambda: False),  # in this suite each wire counts as a separate process
            (sdk_calls, "_kept", []),
            (sdk_calls, "call_in_thread", _call_in_thread),
        ]
        before = [getattr(module, name) for module, name, _ in places]
        for module, name, value in places:
            setattr(module, name, value)
        try:
            async with service.living(), trio.open_nursery() as nursery:
                nursery.start_soon(live)
                yield
                nursery.cancel_scope.cancel()
        finally:
            for (module, name, _), value in zip(places, before, strict=True):
                setattr(module, name, value)

    return Bench(UR("ur5e", "192.0.2.1", {}), lambda: service.log.entries, living, controller)


RIGS: Mapping[str, Rig] = {
    "ur5e": Rig(
        _ur,
        first_joint(0.002, "shoulder_pan_joint"),
        quick=("garbled", "older answers", "flood"),
        floods={
            "texts": p.frame(p.Kind.TEXT),
            "unasked answers": p.frame(p.Kind.START, b"\x01"),
            "lines": b"Stopped?\n",
        },
        bombs={"a packet of 64 kB": b"\xff\xffU", "a line without an end": b"Stop" * 10},
        wrong_ids={"type": lambda data: data.replace(b"U\x01", b"U\x02")},
        bound_s=0.1,  # the published bound
        latest_s={
            # ur-rtde's call runs in a thread.
            Situation.MOVES: THREAD_S,
            Situation.ROOT_ENDS: THREAD_S,
            # The SDK's call does not return, so the wire sends the stop to the dashboard.
            Situation.SILENT: 0.081,
            Situation.RESET: 0.061,
        },
    ),
}
