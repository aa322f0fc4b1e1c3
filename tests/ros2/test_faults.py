"""The process of the bridge is killed or frozen while it carries out a trajectory."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from strands_actors import Robot
from strands_actors.testing import Twin
from tests.answers import state, until
from tests.cli.command import Command
from tests.ports import free_port

from .conftest import World
from .peer import Program, router
from .test_action import Client, goal_of
from .test_motion import pan


@pytest.fixture
def bridged(tmp_path: Path, run_dir: Path) -> Iterator[tuple[World, int]]:
    """An arm behind a twin, and the process id of the bridge that shows it."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = Command(run_dir)
    with Twin("so101", tmp_path) as twin, router(endpoint):
        arm = Robot("so101", mode="real", port=twin.port)
        try:
            assert arm.connect_eagerly() is None
            assert arm.release()["status"] == "success"
            with (
                command.start("ros2", "--namespace", "/lab", "--router", endpoint, "--allow-motion") as bridge,
                Program(endpoint) as program,
            ):
                until(lambda: "/lab/so101/joint_command" in program.names("MS"), "the node")
                yield World(arm, twin, program, None, endpoint), bridge.pid  # type: ignore[arg-type]
                bridge.kill()
        finally:
            arm.cleanup()


@pytest.mark.parametrize("fault", [signal.SIGKILL, pytest.param(signal.SIGSTOP, marks=pytest.mark.long)])
def test_saf_002_a_bridge_that_dies_or_freezes_in_a_trajectory_is_a_hold(
    bridged: tuple[World, int], fault: signal.Signals
) -> None:
    world, pid = bridged
    client, start = Client(world), math.radians(pan(world))
    assert client.send(1, goal_of({20.0: [start + 1.5]}))
    until(lambda: math.radians(pan(world)) > start + 0.02, "it moves")
    os.kill(pid, fault)
    until(lambda: state(world.arm) == "holding", "it holds")
    held_ns, held = time.monotonic_ns(), pan(world)
    if fault == signal.SIGSTOP:
        os.kill(pid, signal.SIGCONT)  # it goes on with its old setpoints
        assert client.result(1)["status"] == 6  # aborted
    time.sleep(0.3)
    assert state(world.arm) == "holding" and abs(pan(world) - held) < 1.0
    assert world.twin.log.host("setpoint", held_ns) == []
