"""A latched setpoint is resent at the rate that its driver declares (SAF-004). In virtual time; the
frames on the wire decide.

The transport resends for every wire, and uses only ``Timing``. So each driver's own ``Timing`` is put on
the fake robot, and the frames are counted.
"""

from __future__ import annotations

import itertools

import msgspec
import pytest
import trio

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import WIRES
from strands_actors.supervisors.gate.messages import Accepted
from strands_actors.testing import FakeHardware, open_inline_tree, run_virtual
from strands_actors.testing.fake import HARDWARE, FakeDriver

from .writer import armed

COUNTED_S = 0.9
"""Shorter than the time that a lease lives without a heartbeat."""
ROUNDING_S = 1e-4
SELDOM_S = 1.0
"""For a driver with a longer period nothing is resent: its wire or its robot keeps the setpoint in force."""


def drivers() -> list[Driver]:
    made = []
    for place in sorted(set(WIRES.values())):
        cls: type[Driver] = load(place)
        port = "" if cls.__name__ == "Stretch" else "127.0.0.1"  # its boards are found by their names
        made.append(cls(cls.SUPPORTED_ROBOTS[0], port, {}))
    return made


@pytest.mark.parametrize("driver", drivers(), ids=lambda driver: driver.robot)
def test_saf_004_a_latched_setpoint_is_resent_at_the_declared_rate(driver: Driver) -> None:
    timing = driver.timing
    cycle_s = max(1.0 / timing.control_hz, timing.tick_s)

    async def run() -> None:
        HARDWARE["rates"] = hardware = FakeHardware(read_s=0.0, confirm_s=0.0)
        fake = FakeDriver("fake", "rates", {})
        fake.timing = msgspec.structs.replace(timing, oneshot_ttl_s=None)
        async with open_inline_tree(hardware, driver=fake) as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(ttl_s=0.25, latched=True, a=1.0), Accepted)
            await trio.sleep(COUNTED_S)
            stamps_ns = [written.t_ns for written in hardware.of("setpoint")]
        gaps_s = [(after - before) / 1e9 for before, after in itertools.pairwise(stamps_ns)]
        if timing.keepalive_s > SELDOM_S:
            assert gaps_s == []
            return
        assert max(gaps_s) <= max(timing.keepalive_s, cycle_s) + ROUNDING_S
        least_s = max(timing.keepalive_s - cycle_s, 1.0 / timing.control_hz - timing.tick_s)
        assert min(gaps_s[1:], default=least_s) >= least_s - ROUNDING_S
        assert stamps_ns[-1] / 1e9 >= stamps_ns[0] / 1e9 + COUNTED_S - timing.keepalive_s - cycle_s

    run_virtual(run)


def test_the_setpoints_of_a_punctual_stream_are_not_resent() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            period_s = tree.driver.timing.keepalive_s
            writer = await armed(tree)
            for number in range(50):
                setpoint = writer.setpoint(ttl_s=0.25, period_s=period_s, a=float(number))
                assert isinstance(await writer.ref.ask(setpoint, 1.0), Accepted)
                await trio.sleep(period_s)
            values = [written.values[0] for written in tree.hardware.of("setpoint")]
        assert values == [float(number) for number in range(50)]

    run_virtual(run)
