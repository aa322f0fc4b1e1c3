"""A stop over a stop channel that is opened for it, which may need a session first or whose session may
fail. In virtual time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import pytest
import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, StopChannel, WireDown
from strands_actors.kernel.clock import Clock, MonotonicClock
from strands_actors.supervisors.root.stop_channel import attempt_anew
from strands_actors.testing import FakeHardware, run_virtual
from strands_actors.testing.fake import HARDWARE, FakeDriver

SAFE = (MotorReport("a", None, written=True, acknowledged=True, safe=True),)
NEVER = 1e3


class Path(StopChannel):
    """A stop channel. ``serve_s`` is the time until it is ready, and ``fails`` the error with which
    serving ends then.
    """

    serve_s: ClassVar[float] = 0.0
    fails: ClassVar[Exception | None] = None
    breaks: ClassVar[Exception | None] = None
    """The error of ``make_safe``."""

    def __init__(self) -> None:
        self.called_s: list[float] = []
        self.closed = False

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        await trio.sleep(self.serve_s)
        if self.fails is not None:
            raise self.fails
        task_status.started()
        await trio.sleep_forever()

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        self.called_s.append(trio.current_time())
        if self.breaks is not None:
            raise self.breaks
        return SAFE

    def close(self) -> None:
        self.closed = True


class Driver(FakeDriver):
    def __init__(self, path: Path) -> None:
        HARDWARE["anew"] = FakeHardware()
        super().__init__("fake", "anew", {})
        self.path = path

    def stop_channel(self, descriptors: Sequence[int], clock: Clock) -> StopChannel:
        return self.path


def attempted(path: Path) -> tuple[tuple[MotorReport, ...], float]:
    """Return the reports, and the time after which ``make_safe`` was called."""
    results: list[tuple[tuple[MotorReport, ...], float]] = []

    async def run() -> None:
        began_s = trio.current_time()
        motors = await attempt_anew(Driver(path), MonotonicClock(), SafeState.LIMP)
        results.append((motors, path.called_s[0] - began_s))

    run_virtual(run)
    assert path.closed
    return results[0]


def made(**fields: object) -> Path:
    return type("Made", (Path,), fields)()


HANDOVER_S = Driver(Path()).timing.handover_s


@pytest.mark.parametrize(
    ("path", "expected_s"),
    [
        (made(), 0.0),
        (made(serve_s=HANDOVER_S / 2), HANDOVER_S / 2),
        (made(serve_s=NEVER), HANDOVER_S),
        (made(serve_s=NEVER, SERVED_FIRST=False), 0.0),
        (made(fails=WireDown("no such robot")), 0.0),
        (made(fails=WireDown("no such robot"), serve_s=HANDOVER_S / 2), HANDOVER_S / 2),
    ],
    ids=["ready", "ready later", "never ready", "not served first", "cannot serve", "cannot serve later"],
)
def test_saf_022_make_safe_is_called_whether_serving_succeeds_or_fails(path: Path, expected_s: float) -> None:
    motors, measured_s = attempted(path)
    assert motors == SAFE
    assert measured_s == pytest.approx(expected_s)


def test_saf_023_a_failing_stop_channel_reports_every_motor_with_the_reason() -> None:
    motors, _ = attempted(made(breaks=OSError("the port is gone")))
    assert [motor.safe for motor in motors] == [False] * len(motors)
    assert all("the port is gone" in motor.detail for motor in motors) and motors
