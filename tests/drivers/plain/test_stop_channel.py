"""Test what stops the robot of a plain class when there is no wire process."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence

import trio

from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.plain.config import PlainConfig
from strands_actors.drivers.plain.driver import PlainDriver
from strands_actors.drivers.plain.stop_channel import WIRE_END_S, PlainStopChannel
from strands_actors.kernel.clock import MonotonicClock

from .rig import SmallArm
from .small_arm import DeclaredArmDriver, PatientArmDriver, SmallArmDriver


def config_of(cls: type, port: str) -> PlainConfig:
    options = PlainDriver.options_of(cls, "small_arm", {"tool_name": "x", "port": port})
    options["config"]["declared"]["keys"] = ["pan.pos", "lift.pos"]
    config: PlainConfig = PlainDriver("small_arm", port, options).config
    return config


def make_safe(config: PlainConfig, descriptors: Sequence[int] = ()) -> tuple[MotorReport, ...]:
    async def main() -> tuple[MotorReport, ...]:
        channel = PlainStopChannel(config, descriptors, MonotonicClock())
        try:
            return await channel.make_safe("stop")
        finally:
            channel.close()

    return trio.run(main)


def test_saf_005_the_report_names_a_missing_stop_channel() -> None:
    for report in make_safe(config_of(SmallArmDriver, "/dev/nowhere")):
        assert not (report.written or report.acknowledged or report.safe)
        assert report.detail.startswith(
            "not confirmed: this driver has no stop channel, and a new process did not stop the robot "
            "(/dev/nowhere cannot be opened"
        )


def test_saf_005_a_stop_channel_of_the_class_that_fails_is_no_success() -> None:
    for report in make_safe(config_of(DeclaredArmDriver, "/dev/nowhere")):
        assert not report.safe
        assert report.detail.startswith("stop_channel: SerialException")


def test_saf_003_a_fresh_process_connects_stops_and_gives_up(small_arm: SmallArm) -> None:
    reports = make_safe(config_of(SmallArmDriver, small_arm.port))
    assert [report.axis for report in reports if report.safe] == ["pan", "lift"]
    assert [line.text for line in small_arm.log] == ["stop", "bye"]


def test_saf_009_no_other_object_is_made_while_the_wire_process_lives(small_arm: SmallArm) -> None:
    ours, theirs = os.pipe()  # the wire process has the other end
    gone_ns: list[int] = []

    async def main() -> None:
        channel = PlainStopChannel(config_of(SmallArmDriver, small_arm.port), [ours], MonotonicClock())

        async def end() -> None:
            await trio.sleep(0.5 * WIRE_END_S)
            assert small_arm.log == []
            gone_ns.append(time.monotonic_ns())
            os.close(theirs)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(channel.serve)
            nursery.start_soon(end)
            reports = await channel.make_safe("stop")
            nursery.cancel_scope.cancel()
        channel.close()
        assert all(report.safe for report in reports)

    trio.run(main)
    assert small_arm.said("stop")[0].t_ns > gone_ns[0]


def test_saf_003_a_stop_after_its_timeout_goes_on_and_answers_the_next_request(
    small_arm: SmallArm,
) -> None:
    async def main() -> None:
        channel = PlainStopChannel(config_of(PatientArmDriver, small_arm.port), [], MonotonicClock())
        small_arm.answers = False

        async def stop() -> None:
            while True:  # on a busy machine no process may start within the channel's time
                await channel.make_safe("stop")

        async with trio.open_nursery() as nursery:
            nursery.start_soon(stop)
            while not small_arm.said("stop"):  # noqa: ASYNC110  # the other process' doing: there is no event
                await trio.sleep(0.01)
            nursery.cancel_scope.cancel()
        small_arm.answers = True
        small_arm.answer("ok")
        reports = await channel.make_safe("stop")
        channel.close()
        assert all(report.safe for report in reports)

    trio.run(main)
    assert [line.text for line in small_arm.log] == ["stop", "bye"]  # once


def test_a_wire_process_that_cannot_be_ended_is_waited_for_no_longer_than_a_second(small_arm: SmallArm) -> None:
    ours, theirs = os.pipe()
    asked_ns = time.monotonic_ns()
    reports = make_safe(config_of(SmallArmDriver, small_arm.port), [ours])
    os.close(theirs)
    assert all(report.safe for report in reports)
    assert small_arm.said("stop")[0].t_ns - asked_ns >= WIRE_END_S * 1e9
