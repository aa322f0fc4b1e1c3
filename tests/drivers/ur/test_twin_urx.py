"""Test the unmodified urx against the twin. It uses only the text ports.

The release in the package index does not know the robot's mode of controllers from software 3.5 on. It takes
every one for stopped, so it cannot wait for a move. Positions and programs are as on a robot.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from strands_actors.testing import Twin
from tests.drivers.packages import URX, run_with

PROGRAM = """
import faulthandler, json, math, os, sys, time
faulthandler.dump_traceback_later(60, exit=True)
from urx.urrobot import URRobot

def until(look):
    deadline = time.monotonic() + 20
    while not look():
        assert time.monotonic() < deadline, "patience is over"
        time.sleep(0.02)

robot = URRobot(sys.argv[1], use_rt=True)
joints = robot.getj()
goal = [joints[0] + 0.2, *joints[1:]]
robot.movej(goal, acc=2, vel=1, wait=False)
until(lambda: math.dist(robot.getj(), goal) < 0.01)
start = robot.getl()
robot.translate((0, 0, -0.05), acc=1, vel=0.3, wait=False)
until(lambda: abs(robot.getl()[2] - start[2] + 0.05) < 0.003)
aside = math.dist(robot.getl()[:2], start[:2])
robot.movels([start, start], acc=1, vel=0.3, wait=False)
until(lambda: math.dist(robot.getl()[:3], start[:3]) < 0.003)
robot.set_tcp((0, 0, 0.1, 0, 0, 0))
until(lambda: abs(math.dist(robot.getl()[:3], start[:3]) - 0.1) < 0.005)
quick = math.dist(robot.rtmon.q_actual(wait=True), goal)
robot.set_digital_out(2, True)
robot.stopj()
print(json.dumps({"aside": aside, "quick": quick}), flush=True)
os._exit(0)
"""


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("ur5e", tmp_path_factory.mktemp("twin")) as process:
        yield process


def test_urx_connects_reads_and_moves(twin: Twin) -> None:
    reported = json.loads(run_with(URX, PROGRAM, twin.port.partition(":")[0]).splitlines()[-1])
    assert reported["aside"] < 0.005, "the tool moves on a straight line"
    assert reported["quick"] < 0.01, "the real-time port reports the same pose"
    kinds = [entry.kind for entry in twin.log.entries()]
    assert kinds.count("enable") >= 5 and kinds.count("safe") == 1
    assert not [entry.data for entry in twin.log.entries() if entry.kind == "error"]
