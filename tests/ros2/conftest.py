"""A twin of an arm on a graph."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from strands_actors import Robot
from strands_actors.surfaces.ros2 import bridge, joints
from strands_actors.surfaces.ros2.bridge import Options
from strands_actors.surfaces.ros2.joints import Layout
from strands_actors.testing import Twin
from tests.answers import until
from tests.ports import free_port

from .peer import Program, router
from .world import RunningBridge


class World(NamedTuple):
    """An armed arm behind a twin, and a program of ROS on the graph that shows it."""

    arm: Any
    twin: Twin
    program: Program
    bridge: RunningBridge
    endpoint: str


LIFETIME_S = 0.6
"""Lifetime of the setpoints in these tests. On a busy machine the usual 0.1 s may pass between two of them."""


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the setpoints of a bridge in this process a longer lifetime."""

    def layout_of(robot_type: str, keys: Sequence[str]) -> Layout | None:
        layout = joints.layout_of(robot_type, keys)
        return None if layout is None else layout._replace(lifetime_s=LIFETIME_S)

    monkeypatch.setattr(bridge, "layout_of", layout_of)


@pytest.fixture
def world(tmp_path: Path, run_dir: Path, patient: None) -> Iterator[World]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    options = Options(namespace="/lab", router=endpoint, allow_motion=True)
    with Twin("so101", tmp_path) as twin, router(endpoint), RunningBridge(options) as running:
        arm = Robot("so101", mode="real", port=twin.port)
        try:
            assert arm.connect_eagerly() is None
            assert arm.release()["status"] == "success"
            with Program(endpoint) as program:
                # This subscription is declared last, after the services.
                until(lambda: "/lab/so101/joint_command" in program.names("MS"), f"the node: {running.lines}")
                yield World(arm, twin, program, running, endpoint)
        finally:
            arm.cleanup()
