"""SAF-024: a stop imports nothing, because an import opens files and waits for the disk. ``Driver.preload``
imports the modules of a stop channel before the root's first heartbeat."""

from __future__ import annotations

import json
import subprocess
import sys

from strands_actors.drivers import WIRES

STOP_EACH = """
import json, os, sys

import trio

import strands_actors.supervisors.root.process
from strands_actors.contract.driver import Reason
from strands_actors.contract.loading import load
from strands_actors.drivers import WIRES
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.supervisors.loading import describe_driver, load_driver
from strands_actors.supervisors.root.stop_channel import attempt_anew

PORTS = {"microduck": "/run/no-robot.sock", "stretch": ""}


def stop(wire):
    driver_class = load(WIRES[wire])
    robot = driver_class.SUPPORTED_ROBOTS[0]
    port = PORTS.get(wire, "/dev/no-robot" if driver_class.PORT_KIND == "serial" else "127.0.0.1")
    driver = load_driver(describe_driver(driver_class, robot, port, driver_class.resolve(robot, {})))
    before = set(sys.modules)

    async def try_to_stop():
        with trio.move_on_after(0.3):  # nobody is there
            await attempt_anew(driver, MonotonicClock(), driver.fallbacks[Reason.WIRE])

    trio.run(try_to_stop)
    print(json.dumps([wire, sorted(set(sys.modules) - before)]), flush=True)


for wire in WIRES:  # each in a process of its own: one driver's imports are not another's
    pid = os.fork()
    if pid == 0:
        try:
            stop(wire)
        finally:
            os._exit(0)
    os.waitpid(pid, 0)
"""


def test_saf_024_a_stop_imports_nothing() -> None:
    done = subprocess.run([sys.executable, "-c", STOP_EACH], capture_output=True, text=True, timeout=100)
    imported = dict(map(json.loads, done.stdout.splitlines()))
    assert imported == {wire: [] for wire in WIRES}, done.stderr
