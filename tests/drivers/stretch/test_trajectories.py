"""Test the trajectories of a stepper board of the twin, by the calls of the protocol."""

from __future__ import annotations

import struct

import pytest

from strands_actors.drivers.stretch import frames as f
from strands_actors.drivers.stretch import protocol as p
from strands_actors.drivers.stretch.twin.boards import StepperDecoder
from strands_actors.drivers.stretch.twin.stepper import StepperMotor
from strands_actors.drivers.stretch.twin.world import World

from .test_twin import Clock

S = 2.0
"""Duration of a segment in seconds."""


class Bench:
    """The arm's board of a twin, and a client that calls it. ``sync`` switches its sync mode on."""

    def __init__(self, sync: bool = False) -> None:
        self.clock = Clock()
        self.world = World("stretch3", self.clock)
        self.arm: StepperMotor = self.world.steppers["arm"]
        config = self.arm.gains.config & ~int(p.Config.SYNC) | (p.Config.SYNC if sync else 0)
        self.arm.gains = self.arm.gains._replace(config=int(config))
        self._decoder = StepperDecoder(self.world, self.arm)
        self.rad_per_m = self.world.config.motors["arm"].rad_per_m

    def call(self, data: bytes) -> bytes:
        """Send a call to the board. Return the data of its reply, without the number."""
        content = b""
        for frame in f.pushes(data):
            for received in self._decoder.frames(frame, None):
                for reply in received.act().replies:
                    content = b"".join(part.data for part in f.Decoder().feed(reply.data))
        assert content[:1] == bytes((data[0] + 1,))
        return content[1:]

    def segment(self, call: int, number: int, begin_m: float, end_m: float, duration_s: float = S) -> bytes:
        """Send a segment that begins and ends at rest."""
        begin, way = begin_m * self.rad_per_m, (end_m - begin_m) * self.rad_per_m
        cubic = (begin, 0.0, 0.0, 10 * way / S**3, -15 * way / S**4, 6 * way / S**5)
        return self.call(struct.pack("<B7fB", call, duration_s, *cubic, number))

    def begin(self) -> None:
        own = self.world.config.motors["arm"]
        positive, negative = own.contact_a
        command = p.Command(
            p.Mode.WAYPOINTS, velocity=0.4 * own.rad_per_m, contact_pos_a=positive, contact_neg_a=negative
        )
        self.call(command.call())

    def run(self, seconds: float) -> p.StepperStatus:
        for _ in range(round(seconds / 0.01)):
            self.clock.now_s += 0.01
            self.world.pass_time()
        return self.arm.status()

    @property
    def metres(self) -> float:
        return self.world.metres("arm")


def test_a_trajectory_runs_segment_by_segment_and_ends_with_the_last() -> None:
    bench = Bench()
    bench.begin()
    assert bench.segment(p.START_TRAJECTORY, 2, 0.1, 0.2) == b"\1"
    status = bench.run(S / 2)
    assert status.has(p.Diag.TRAJECTORY_ACTIVE) and status.waypoint == 2
    assert bench.metres == pytest.approx(0.15, abs=3e-3), "it is half way"
    assert status.trajectory / bench.rad_per_m == pytest.approx(0.15, abs=1e-3)
    bench.segment(p.NEXT_SEGMENT, 3, 0.2, 0.05)
    assert bench.run(S / 2 + 0.1).waypoint == 3
    status = bench.run(S)
    assert bench.metres == pytest.approx(0.05, abs=1e-3)
    assert not status.has(p.Diag.TRAJECTORY_ACTIVE) and status.waypoint == 0 and status.mode == p.Mode.WAYPOINTS
    assert bench.run(1.0).velocity == 0.0


@pytest.mark.parametrize("number", [0, 1, 3])
def test_a_trajectory_begins_with_the_segment_2(number: int) -> None:
    bench = Bench()
    bench.begin()
    assert bench.segment(p.START_TRAJECTORY, number, 0.1, 0.2) == b"\0"
    assert not bench.run(1.0).has(p.Diag.TRAJECTORY_ACTIVE) and bench.metres == pytest.approx(0.1)
    assert bench.call(bytes((p.START_TRAJECTORY,))) == b"\0", "a segment without its numbers"


def test_a_running_trajectory_takes_only_the_segment_that_follows() -> None:
    bench = Bench()
    bench.begin()
    bench.segment(p.START_TRAJECTORY, 2, 0.1, 0.2)
    assert bench.segment(p.START_TRAJECTORY, 2, 0.1, 0.3) == b"\0"
    bench.segment(p.NEXT_SEGMENT, 4, 0.2, 0.4)
    bench.segment(p.NEXT_SEGMENT, 3, 0.2, 0.4)
    bench.segment(p.NEXT_SEGMENT, 3, 0.2, 0.4, duration_s=0.0)  # none follows
    bench.run(2 * S)
    assert bench.metres == pytest.approx(0.2, abs=1e-3)


def test_a_reset_ends_it_where_it_is() -> None:
    bench = Bench()
    bench.begin()
    bench.segment(p.START_TRAJECTORY, 2, 0.1, 0.3)
    bench.run(S / 2)
    bench.call(bytes((p.RESET_TRAJECTORY,)))
    status = bench.run(S)
    assert not status.has(p.Diag.TRAJECTORY_ACTIVE) and bench.metres == pytest.approx(0.2, abs=0.01)


def test_in_sync_mode_it_waits_for_the_pulse() -> None:
    bench = Bench(sync=True)
    bench.begin()
    assert bench.segment(p.START_TRAJECTORY, 2, 0.1, 0.2) == b"\1"
    status = bench.run(1.0)
    assert status.has(p.Diag.TRAJECTORY_WAITS) and status.has(p.Diag.WAITS_FOR_SYNC) and status.waypoint == 1
    assert bench.metres == pytest.approx(0.1)
    bench.world.sync()
    bench.run(S + 0.5)
    assert bench.metres == pytest.approx(0.2, abs=1e-3)


def test_it_keeps_within_the_limits_of_motion_and_ends_at_a_contact() -> None:
    bench = Bench()
    bench.arm.limits = (0.0, 0.15 * bench.rad_per_m)
    bench.begin()
    bench.segment(p.START_TRAJECTORY, 2, 0.1, 0.2)
    bench.run(S)
    assert bench.metres == pytest.approx(0.15, abs=1e-3)
    bench.arm.limits = None
    bench.begin()
    bench.world.set_contact("arm", True)
    bench.segment(p.START_TRAJECTORY, 2, 0.15, 0.3)
    status = bench.run(S)
    assert status.has(p.Diag.CONTACT) and status.mode == p.Mode.SAFETY
    assert not status.has(p.Diag.TRAJECTORY_ACTIVE) and bench.metres == pytest.approx(0.15, abs=1e-3)


def test_the_safety_mode_never_waits_for_a_pulse() -> None:
    bench = Bench(sync=True)
    bench.call(bench.world.config.goal("arm", 0.4).call())
    bench.world.sync()
    bench.run(1.0)
    bench.call(p.Command(p.Mode.SAFETY).call())
    assert bench.run(0.01).mode == p.Mode.SAFETY
