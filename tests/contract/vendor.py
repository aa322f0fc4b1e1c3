"""A stop channel on a vendor's SDK that can hang, for the tests of channels in separate processes.

Files in its folder control it. ``hang``, ``spin``, ``slow`` and ``crash`` are used once, the others on every
call. ``block PID`` blocks the idle process with this pid.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
import trio

from strands_actors.contract import Clock, MotorReport, StopChannel, WireDown


class VendorConfig(msgspec.Struct, frozen=True):
    folder: str
    axes: tuple[str, ...]


class VendorStopChannel(StopChannel):
    def __init__(self, config: VendorConfig, descriptors: Sequence[int], clock: Clock) -> None:
        assert isinstance(config, VendorConfig)
        self._folder = Path(config.folder)
        self._axes = config.axes
        self._descriptors = descriptors
        self._note("began")
        if (self._folder / "hang-at-start").exists():
            time.sleep(3600)

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        if (self._folder / "unreachable").exists():
            raise WireDown("no route to the robot")
        task_status.started()
        while True:
            if self._once(f"block {os.getpid()}"):
                self._note("blocks")
                time.sleep(3600)  # noqa: ASYNC251  # an SDK that keeps the interpreter's lock
            await trio.sleep(0.01)

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        if (self._folder / "hang-always").exists() or self._once("hang"):
            self._note("hangs")
            time.sleep(3600)  # noqa: ASYNC251  # a call of an SDK that never returns
        if self._once("spin"):
            self._note("spins")
            while True:
                pass
        if self._once("crash"):
            os._exit(3)
        if self._once("slow"):
            self._note("slow")
            await trio.sleep(3600)
        if (self._folder / "connect").exists():
            try:
                os.close(os.open(os.devnull, os.O_RDWR))  # like a connection that is opened for the stop
            except OSError as error:
                return tuple(
                    MotorReport(axis, at, False, False, False, str(error)) for at, axis in enumerate(self._axes)
                )
        self._note(safe_state)
        for descriptor in self._descriptors:
            os.write(descriptor, safe_state.encode())
        return tuple(MotorReport(axis, at, True, True, True, safe_state) for at, axis in enumerate(self._axes))

    def close(self) -> None:
        self._note("closed")

    def _once(self, name: str) -> bool:
        try:
            (self._folder / name).unlink()
        except FileNotFoundError:
            return False
        return True

    def _note(self, what: str) -> None:
        with (self._folder / "notes").open("a") as notes:
            notes.write(f"{os.getpid()} {what}\n")
