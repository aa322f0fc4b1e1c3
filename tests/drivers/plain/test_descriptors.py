"""The stop channel's descriptor is found by the device, for any library that has opened it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import rustypot

from strands_actors.drivers.plain.lerobot import descriptors
from strands_actors.drivers.plain.lerobot.descriptors import descriptors_of, devices_in
from strands_actors.testing import Twin
from tests.ordinary_user import as_ordinary_user

ROOT = Path(__file__).resolve().parents[3]
SUITE = "tests/drivers/plain/rustypot_suite.py"

INHERITED = ("PYTEST_", "STRANDS_ACTORS_")
"""Variables of this run of the tests, which are not those of the suite that it starts."""
PATIENCE_S = 120.0


def test_the_devices_of_a_robot_are_those_that_its_options_name(tmp_path: Path) -> None:
    robot, port = os.openpty()
    link = tmp_path / "by-id"
    link.symlink_to(os.ttyname(port))
    number = os.fstat(port).st_rdev
    options = {"id": "left", "gain": 3, "left_arm_config": {"port": str(link)}, "folder": str(tmp_path)}
    assert devices_in(options) == {number}
    assert devices_in({"port": str(tmp_path / "gone"), "host": "10.0.0.2"}) == frozenset()
    for descriptor in (robot, port):
        os.close(descriptor)


def test_a_descriptor_that_has_hung_up_is_not_chosen_while_another_lives(monkeypatch: pytest.MonkeyPatch) -> None:
    """After the cable was pulled and put back, the library has opened the same device anew."""
    old_robot, old = os.openpty()
    robot, port = os.openpty()
    os.close(old_robot)
    number = os.fstat(port).st_rdev
    # The kernel gives a number anew only when nobody has the old device open. That of a USB adapter comes back.
    of_port = {old: number, port: number}
    monkeypatch.setattr(descriptors, "_open_device", of_port.get)
    assert descriptors_of(frozenset({number})) == [port]
    del of_port[port]
    assert descriptors_of(frozenset({number})) == [old], "the only one"
    for descriptor in (old, robot, port):
        os.close(descriptor)


def test_a_bus_that_shows_no_descriptor_is_found(tmp_path: Path) -> None:
    servo = rustypot.Sts3215PyController.definition()
    with Twin("so101", tmp_path) as twin:
        devices = devices_in({"port": twin.port})
        assert descriptors_of(devices) == []
        with rustypot.Bus(twin.port, 1_000_000, 0.1, {1: servo}) as bus:
            (port,) = descriptors_of(devices)
            os.set_blocking(port, False)  # as it is for a stop channel; the bus still works
            assert bus.read_register(1, "model_number") == 777
        assert descriptors_of(devices) == []


def test_the_stops_work_on_a_port_that_an_ordinary_user_cannot_open_twice() -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", SUITE]
    environment = {name: value for name, value in os.environ.items() if not name.startswith(INHERITED)}
    done = subprocess.run(
        as_ordinary_user(command), cwd=ROOT, env=environment, capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert done.returncode == 0, done.stdout + done.stderr
