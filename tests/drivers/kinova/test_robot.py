"""Test what surrounds the tree: recordings, certificates, passwords, the simulation."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot, SimRobot
from strands_actors.caller.resolve.planning import plan
from strands_actors.contract.driver import Reason
from strands_actors.drivers import canonical_name, list_driver_coverage, port_kind
from strands_actors.drivers.kinova.driver import Kinova
from strands_actors.supervisors.loading import describe_driver, without_secrets
from strands_actors.surfaces.drill.certificate import TWIN, config_of
from strands_actors.surfaces.recording import read, replay
from tests.answers import json_of, status, until, why
from tests.drivers.common.twin_process import TwinProcess
from tests.trees import connected

PASSWORD = "hunter2"
RECORDER = "from strands_actors.surfaces.cli import main; main()"


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[RealRobot]:
    """Yield an arm on a twin with a different password."""
    options = {"username": "me", "password": PASSWORD}
    with TwinProcess(tmp_path, "kinova_gen3", "kinova", options=options) as twin:
        robot = Robot("kinova_gen3", mode="real", port=twin.port, **options)
        until(lambda: robot.connect_eagerly() is None, "it is connected")
        try:
            yield robot
        finally:
            robot.cleanup()


def test_it_is_listed() -> None:
    assert list_driver_coverage()["kinova_gen3"] == ("strands",)
    assert (canonical_name("kinova_gen3"), port_kind("kinova_gen3")) == ("kinova_gen3", "address")


def test_a_misspelt_keyword_is_refused_with_the_nearest() -> None:
    with pytest.raises(ValueError, match="'pasword' -> 'password'"):
        Robot("kinova_gen3", mode="real", port="192.0.2.10", pasword="x")


def test_a_recording_replays_with_equal_decisions_and_holds_no_password(arm: RealRobot, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
    with subprocess.Popen(
        [sys.executable, "-c", RECORDER, "record", "kinova_gen3", "-o", str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
        env=environment,
    ) as recorder:
        try:
            assert recorder.stderr is not None
            assert recorder.stderr.readline().startswith("recording kinova_gen3")
            start = arm.get_observation()["joint_1"]
            for step in range(1, 30):
                json_of(arm.send_action({"joint_1": start + 0.004 * step}))
                time.sleep(0.02)
            assert "needs" in why(arm.send_action({"joint_1": start + 9.0}))
            json_of(arm.stop())
            assert "resume() first" in why(arm.send_action({"joint_1": start}))
            json_of(arm.resume())
            recorder.send_signal(signal.SIGINT)
            _, errors = recorder.communicate(timeout=60.0)
        finally:
            recorder.kill()
    assert recorder.returncode == 0, errors
    recording = read(path)
    outcome = replay(recording)
    assert outcome.equal, outcome.difference
    assert outcome.gaps == 0 and outcome.steps > 100
    assert recording.info.attached.driver["options"] == {
        "username": "me",
        "control_frequency": 40.0,
        "gripper": None,
    }
    assert PASSWORD not in str(recording)


def test_no_answer_has_the_password(arm: RealRobot) -> None:
    said = [arm.get_status(), arm.get_task_status(), arm.tree(), repr(arm), repr(arm._plan), arm.tool_spec]
    assert PASSWORD not in str(said)


def test_no_process_shows_the_password_in_its_command_line(arm: RealRobot) -> None:
    tree = arm.tree()
    assert tree is not None
    for process in tree["processes"]:
        for file in ("cmdline", "environ"):
            assert PASSWORD.encode() not in Path(f"/proc/{process['pid']}/{file}").read_bytes()


def test_a_certificate_does_not_depend_on_the_password_but_on_the_rest() -> None:
    def config(**options: object) -> str:
        wanted = plan("kinova_gen3", "real", port="192.0.2.10", **options)
        return config_of(wanted.driver_class, wanted.robot, TWIN, wanted.options)

    assert config() == config(password=PASSWORD)
    assert config() != config(control_frequency=20.0)


def test_a_driver_without_its_password_is_still_built() -> None:
    options = Kinova.resolve("kinova_gen3", {"password": PASSWORD, "control_frequency": 20})
    description = describe_driver(Kinova, "kinova_gen3", "192.0.2.10", options)
    public = without_secrets(description, Kinova)
    assert PASSWORD not in str(public) and description["options"]["password"] == PASSWORD
    assert Kinova("kinova_gen3", "", public["options"]).timing.control_hz == 20.0


# -- the simulation


def test_it_is_simulated_without_gates_and_driven_on_its_wire(run_dir: Path) -> None:
    sim = Robot("kinova_gen3")
    assert isinstance(sim, SimRobot)
    real = Robot("kinova_gen3", mode="real", transport="twin", sim=sim)
    try:
        assert sim.connect_eagerly() is None
        answer = json_of(sim.send_action({"joint_1": 0.8, "joint_2": -0.4}))
        assert answer["joints"] == ["joint_1", "joint_2"]
        until(lambda: abs(sim.get_observation()["joint_1"] - 0.8) < 0.02, "it is there")
        assert "joint_9 is not a joint" in why(sim.send_action({"joint_9": 0.0}))

        connected(real)  # refused while the arm, which has just arrived, still sways
        seen = real.get_observation()
        assert seen["joint_1"] == pytest.approx(0.8, abs=0.02)
        json_of(real.send_action({"joint_1": seen["joint_1"] - 0.02}))
        until(lambda: "held by the robot" in str(status(sim)["faults"]), "the wire has it")
        until(lambda: "is held by the robot on its wire" in why(sim.send_action({"joint_1": 0.0})), "it is refused")
        json_of(real.stop())
        until(lambda: sim.stop()["status"] == "success", "let go of on the wire")
        json_of(sim.resume())
        json_of(sim.send_action({"joint_1": 0.0}))
        until(lambda: abs(sim.get_observation()["joint_1"]) < 0.02, "it is there")
    finally:
        real.cleanup()
        sim.cleanup()


def test_every_reason_has_a_published_bound() -> None:
    arm = Kinova("kinova_gen3", "", {})
    assert set(arm.fallbacks) == set(Reason)
    assert arm.bound_s == 0.05 and math.isclose(arm.timing.heartbeat_ttl_s, 0.075)
