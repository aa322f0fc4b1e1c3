"""Test the vendor's unmodified clients against the twin: panda-python (FCI 5) and pylibfranka (FCI 10).

They run in separate processes. Their constructors wait for ever for a frozen controller, one of them with the
interpreter's lock.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from tests.answers import PATIENCE_S, json_of
from tests.drivers.common.twin_process import TwinProcess

from .arms_on_twins import away, wait_at

PRELUDE = """
import json, math, os, sys, time, warnings
host = sys.argv[1]

def end(**told):
    print(json.dumps(told), flush=True)
    os._exit(0)

"""
PANDA = """
import panda_py
from panda_py import controllers, libfranka
panda = panda_py.Panda(host, realtime_config=libfranka.RealtimeConfig.kIgnore)
"""
FR3 = """
import pylibfranka as franka
robot = franka.Robot(host, franka.RealtimeConfig.kIgnore)
"""


def twin_of(robot: str, directory: Path, **options: Any) -> TwinProcess:
    """Return a twin that waits for its client: these clients run without priority, and one of them in Python."""
    return TwinProcess(directory, robot, "franka", options={"stretches": "always", **options})


@pytest.fixture
def panda(tmp_path: Path) -> Iterator[TwinProcess]:
    with twin_of("panda", tmp_path) as process:
        yield process


@pytest.fixture
def fr3(tmp_path: Path) -> Iterator[TwinProcess]:
    with twin_of("fr3", tmp_path) as process:
        yield process


@contextlib.contextmanager
def program(twin: TwinProcess, text: str) -> Iterator[subprocess.Popen[str]]:
    client = subprocess.Popen(
        [sys.executable, "-c", PRELUDE + text, twin.port.partition(":")[0]],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield client
    finally:
        client.kill()
        client.communicate()


def hear(client: subprocess.Popen[str], word: str) -> None:
    """Wait until the program prints this word."""
    assert client.stdout is not None
    while word not in (line := client.stdout.readline()):
        assert line, "the client has ended"


def told_by(client: subprocess.Popen[str]) -> dict[str, Any]:
    """Return the result that the program prints at its end."""
    said, _ = client.communicate(timeout=3 * PATIENCE_S)
    lines = [line for line in said.splitlines() if line.startswith("{")]
    assert client.returncode == 0 and lines, said
    reported: dict[str, Any] = json.loads(lines[-1])
    return reported


def run(twin: TwinProcess, text: str) -> dict[str, Any]:
    with program(twin, text) as client:
        return told_by(client)


# -- FCI 5


@pytest.mark.needs("panda-python")
def test_panda_python_connects_reads_moves_and_loads_the_model(panda: TwinProcess) -> None:
    reported = run(
        panda,
        PANDA
        + """
first = panda.get_state()
goal = [rad + 0.1 for rad in panda.q]
moved = panda.move_to_joint_position(goal, speed_factor=0.2)
reached = max(abs(there - here) for there, here in zip(goal, panda.get_state().q))
started = panda.move_to_start()
coriolis = list(panda.get_model().coriolis(panda.get_state()))
end(mode=str(first.robot_mode), moved=moved, reached=reached, started=started, pose=list(first.O_T_EE),
    coriolis=coriolis)
""",
    )
    assert reported["mode"] == "RobotMode.kIdle"
    assert reported["moved"] and reported["started"]
    assert reported["reached"] < 0.01
    assert reported["pose"][12:15] == pytest.approx([0.3069, 0.0, 0.5903], abs=1e-3)  # the vendor's start pose
    assert reported["coriolis"] == [0.0] * 7
    kinds = [kind for kind, _ in panda.logged("host")]
    assert kinds.count("enable") == 2 and kinds.count("setpoint") > 1000


@pytest.mark.needs("panda-python")
def test_panda_python_runs_its_controller_and_stops_it(panda: TwinProcess) -> None:
    reported = run(
        panda,
        PANDA
        + """
q = list(panda.q)
controller = controllers.JointPosition()
panda.start_controller(controller)
with panda.create_context(frequency=200, max_runtime=1.0) as context:
    while context.ok():
        controller.set_control([rad + 0.05 * math.sin(math.pi * min(context.time, 0.5)) for rad in q])
moved = panda.get_state().q[0] - q[0]
panda.stop_controller()
end(moved=moved, mode=str(panda.get_state().robot_mode))
""",
    )
    assert reported["moved"] == pytest.approx(0.05, abs=0.015)
    assert reported["mode"] == "RobotMode.kIdle"


@pytest.mark.needs("panda-python")
def test_panda_python_sees_a_reflex_and_recovers(panda: TwinProcess) -> None:
    with program(
        panda,
        PANDA
        + """
print("ready", flush=True)
while panda.get_state().robot_mode == libfranka.RobotMode.kIdle:
    pass
reflex = str(panda.get_state().robot_mode)
errors = str(panda.get_state().last_motion_errors)
panda.recover()
end(reflex=reflex, errors=errors, after=str(panda.get_state().robot_mode), moved=panda.move_to_start())
""",
    ) as client:
        hear(client, "ready")
        panda.command("reflex joint_reflex")
        reported = told_by(client)
    assert reported["reflex"] == "RobotMode.kReflex"
    assert "joint_reflex" in reported["errors"]
    assert reported["after"] == "RobotMode.kIdle"
    assert reported["moved"]


@pytest.mark.needs("panda-python")
def test_panda_python_gets_an_error_for_the_other_version(tmp_path: Path) -> None:
    with twin_of("panda", tmp_path, fci=10) as twin:
        reported = run(
            twin,
            """
import panda_py
from panda_py import libfranka
try:
    panda_py.Panda(host, realtime_config=libfranka.RealtimeConfig.kIgnore)
except Exception as error:
    end(error=str(error))
""",
        )
    assert "version 10" in reported["error"] and "version 5" in reported["error"], reported


# -- FCI 10


@pytest.mark.needs("pylibfranka")
def test_pylibfranka_connects_reads_and_loads_the_model(fr3: TwinProcess) -> None:
    reported = run(
        fr3,
        FR3
        + """
state = robot.read_once()
gravity = robot.load_model().gravity(state)
end(mode=str(state.robot_mode), q=list(state.q), pose=list(state.O_T_EE), gravity=len(list(gravity)))
""",
    )
    assert reported["mode"] == "RobotMode.Idle"
    assert reported["q"] == pytest.approx([0, -0.7854, 0, -2.3562, 0, 1.5708, 0.7854], abs=1e-3)
    assert reported["pose"][12:15] == pytest.approx([0.3069, 0.0, 0.5903], abs=1e-3)
    assert reported["gravity"] == 7


MOVE = """
active = robot.start_joint_position_control(franka.ControllerMode.JointImpedance)
start, elapsed, cycles = None, 0.0, 0
while elapsed < 1.0:
    state, duration = active.readOnce()
    start = start or list(state.q_d)
    elapsed, cycles = elapsed + duration.to_sec(), cycles + 1
    swing = 0.05 * (1 - math.cos(math.pi * min(elapsed, 1.0)))
    command = franka.JointPositions([rad + swing for rad in start])
    command.motion_finished = elapsed >= 1.0
    active.writeOnce(command)
"""


@pytest.mark.needs("pylibfranka")
def test_pylibfranka_moves_at_1_khz(fr3: TwinProcess) -> None:
    reported = run(
        fr3,
        FR3
        + MOVE
        + """
for _ in range(300):
    state = robot.read_once()
end(cycles=cycles, moved=[there - here for there, here in zip(state.q, start)], mode=str(state.robot_mode))
""",
    )
    assert reported["cycles"] > 900
    assert reported["moved"] == pytest.approx([0.1] * 7, abs=0.01)
    assert reported["mode"] == "RobotMode.Idle"


@pytest.mark.needs("pylibfranka")
def test_pylibfranka_is_stopped_by_a_guard_and_recovers(fr3: TwinProcess) -> None:
    """The program jumps. The controller's guard ends the motion and names the reason, and the fault is cleared."""
    reported = run(
        fr3,
        FR3
        + """
active = robot.start_joint_position_control(franka.ControllerMode.JointImpedance)
try:
    for cycle in range(200):
        state, _ = active.readOnce()
        start = list(state.q_d) if cycle == 0 else start
        active.writeOnce(franka.JointPositions([rad + (0.2 if cycle > 50 else 0.0) for rad in start]))
    error = ""
except Exception as failure:
    error = str(failure)
reflex = str(robot.read_once().robot_mode)
del active
robot.automatic_error_recovery()
"""
        + MOVE
        + "end(error=error, reflex=reflex, cycles=cycles)",
    )
    assert "joint_motion_generator_velocity_limits_violation" in reported["error"]
    assert reported["reflex"] == "RobotMode.Reflex"
    assert reported["cycles"] > 900


@pytest.mark.needs("pylibfranka")
def test_pylibfranka_gets_an_error_for_the_other_version(tmp_path: Path) -> None:
    with twin_of("fr3", tmp_path, fci=5) as twin:
        reported = run(
            twin,
            """
import pylibfranka as franka
try:
    franka.Robot(host, franka.RealtimeConfig.kIgnore)
except Exception as error:
    end(error=str(error))
""",
        )
    assert "version: 5" in reported["error"], reported


# -- both


@pytest.mark.parametrize(
    ("robot", "text"),
    [
        pytest.param("panda", PANDA, marks=pytest.mark.needs("panda-python")),
        pytest.param("fr3", FR3, marks=pytest.mark.needs("pylibfranka")),
    ],
)
def test_saf_003_a_client_that_is_killed_leaves_an_arm_that_stands(robot: str, text: str, tmp_path: Path) -> None:
    """The connection ends with the process, and the controller then ends the motion."""
    with twin_of(robot, tmp_path) as twin:
        motion = (
            "print('moving', flush=True); panda.move_to_joint_position([rad + 1.0 for rad in panda.q], 0.2)"
            if robot == "panda"
            else "print('moving', flush=True)\n" + MOVE.replace("elapsed < 1.0", "True").replace(">= 1.0", "> 99")
        )
        with program(twin, text + motion) as client:
            hear(client, "moving")
            while len([kind for kind, _ in twin.logged("host") if kind == "setpoint"]) < 50:
                assert client.poll() is None
        while ("aborted", "") not in twin.logged("robot"):
            assert twin.process.poll() is None
        assert [kind for kind, _ in twin.logged("host")][-1] in ("setpoint", "other")


# -- Cartesian motions

PANDA_ROBOT = """
from panda_py import libfranka
robot = libfranka.Robot(host, realtime_config=libfranka.RealtimeConfig.kIgnore)
"""
CIRCLE = """
start, elapsed = None, 0.0
while elapsed < 1.0:
    state, duration = active.readOnce()
    start = start or list(state.O_T_EE_d)
    elapsed += duration.to_sec()
    angle = math.pi / 8 * (1 - math.cos(math.pi * min(elapsed, 1.0)))
    pose = list(start)
    pose[12] += 0.1 * math.sin(angle)
    pose[14] += 0.1 * (math.cos(angle) - 1)
    command = franka.CartesianPose(pose)
    command.motion_finished = elapsed >= 1.0
    active.writeOnce(command)
"""


def ends_on_the_circle(reported: dict[str, Any]) -> None:
    moved = [there - here for there, here in zip(reported["end"][12:15], reported["start"][12:15], strict=True)]
    assert moved == pytest.approx([0.1 * 0.7071, 0.0, -0.1 * 0.2929], abs=2e-3)
    assert reported["end"][:12] == pytest.approx(reported["start"][:12], abs=2e-3)


@pytest.mark.needs("pylibfranka")
def test_pylibfranka_leads_the_end_effector_along_poses(fr3: TwinProcess) -> None:
    """As in the vendor's example: with its own stiffness, then from the commanded pose."""
    reported = run(
        fr3,
        FR3
        + """
robot.set_joint_impedance([3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0])
robot.set_cartesian_impedance([3000.0, 3000.0, 3000.0, 300.0, 300.0, 300.0])
active = robot.start_cartesian_pose_control(franka.ControllerMode.JointImpedance)
"""
        + CIRCLE
        + """
for _ in range(300):
    state = robot.read_once()
end(start=start, end=list(state.O_T_EE), mode=str(state.robot_mode))
""",
    )
    assert reported["mode"] == "RobotMode.Idle"
    ends_on_the_circle(reported)


@pytest.mark.needs("pylibfranka")
def test_pylibfranka_leads_the_end_effector_at_a_velocity(fr3: TwinProcess) -> None:
    reported = run(
        fr3,
        FR3
        + """
start = list(robot.read_once().O_T_EE)
active = robot.start_cartesian_velocity_control(franka.ControllerMode.CartesianImpedance)
elapsed = 0.0
while elapsed < 1.0:
    state, duration = active.readOnce()
    elapsed += duration.to_sec()
    speed = 0.05 * (1.0 - math.cos(2.0 * math.pi * min(elapsed, 1.0)))
    command = franka.CartesianVelocities([speed, 0.0, -speed, 0.0, 0.0, 0.0])
    command.motion_finished = elapsed >= 1.0
    active.writeOnce(command)
for _ in range(300):
    state = robot.read_once()
end(start=start, end=list(state.O_T_EE))
""",
    )
    moved = [there - here for there, here in zip(reported["end"][12:15], reported["start"][12:15], strict=True)]
    assert moved == pytest.approx([0.05, 0.0, -0.05], abs=3e-3)


@pytest.mark.needs("pylibfranka")
def test_pylibfranka_is_told_which_cartesian_limit_it_violates(fr3: TwinProcess) -> None:
    reported = run(
        fr3,
        FR3
        + """
active = robot.start_cartesian_pose_control(franka.ControllerMode.JointImpedance)
try:
    for cycle in range(200):
        state, _ = active.readOnce()
        start = list(state.O_T_EE_d) if cycle == 0 else start
        pose = list(start)
        pose[13] += 0.02 if cycle > 50 else 0.0
        active.writeOnce(franka.CartesianPose(pose))
    error = ""
except Exception as failure:
    error = str(failure)
end(error=error)
""",
    )
    assert "cartesian_motion_generator_velocity_limits_violation" in reported["error"]


@pytest.mark.needs("pylibfranka")
def test_pylibfrankas_asynchronous_motions_are_not_possible(fr3: TwinProcess) -> None:
    reported = run(
        fr3,
        FR3
        + """
handler = franka.AsyncPositionControlHandler
result = handler.configure(robot, handler.Configuration([0.5] * 7, 0.01))
end(error=result.error_message or "", mode=str(robot.read_once().robot_mode))
""",
    )
    assert "command not possible in the current mode" in reported["error"], reported
    assert reported["mode"] == "RobotMode.Idle"


@pytest.mark.needs("panda-python")
def test_libfranka_leads_the_end_effector_and_its_elbow(panda: TwinProcess) -> None:
    """With the filter and the limits of libfranka 0.9.2, which compute with the commanded values of each state."""
    reported = run(
        panda,
        PANDA_ROBOT
        + """
seen = {}
def circle(state, duration):
    seen.setdefault("start", list(state.O_T_EE_c))
    seen["time"] = seen.get("time", 0.0) + duration.to_sec()
    angle = math.pi / 8 * (1 - math.cos(math.pi * min(seen["time"], 1.0)))
    pose = list(seen["start"])
    pose[12] += 0.1 * math.sin(angle)
    pose[14] += 0.1 * (math.cos(angle) - 1)
    command = libfranka.CartesianPose(pose)
    command.motion_finished = seen["time"] >= 1.1
    return command
robot.control_cartesian_pose(circle)
end_pose = list(robot.read_once().O_T_EE_d)
began = list(robot.read_once().elbow_d)
seen["time"] = 0.0
def swing(state, duration):
    seen["time"] += duration.to_sec()
    seen.setdefault("pose", list(state.O_T_EE_c))
    elbow = [began[0] + 0.1 * (1 - math.cos(math.pi * min(seen["time"], 1.0))), began[1]]
    command = libfranka.CartesianPose(seen["pose"], elbow)
    command.motion_finished = seen["time"] >= 1.1
    return command
robot.control_cartesian_pose(swing)
state = robot.read_once()
end(start=seen["start"], end=end_pose, elbow=state.elbow_d[0] - began[0], still=list(state.O_T_EE_d))
""",
    )
    ends_on_the_circle(reported)
    assert reported["elbow"] == pytest.approx(0.2, abs=2e-3)
    assert reported["still"] == pytest.approx(reported["end"], abs=2e-3)


@pytest.mark.needs("panda-python")
def test_libfranka_gets_the_controllers_inverse_kinematics_for_its_torques(panda: TwinProcess) -> None:
    """As in the vendor's example joint_impedance_control."""
    reported = run(
        panda,
        PANDA_ROBOT
        + """
seen = {"time": 0.0}
def lift(state, duration):
    seen["time"] += duration.to_sec()
    seen.setdefault("start", list(state.O_T_EE_d))
    pose = list(seen["start"])
    pose[14] += 0.03 * (1 - math.cos(math.pi * min(seen["time"], 1.0)))
    command = libfranka.CartesianPose(pose)
    command.motion_finished = seen["time"] >= 1.5
    return command
def torques(state, duration):
    return libfranka.Torques([300 * (d - q) - 25 * v for d, q, v in zip(state.q_d, state.q, state.dq)])
robot.control_torque_cartesian_pose(torques, lift)
end(start=seen["start"], end=list(robot.read_once().O_T_EE))
""",
    )
    assert reported["end"][14] - reported["start"][14] == pytest.approx(0.06, abs=5e-3)


# -- where the states come from


@pytest.mark.needs("panda-python")
def test_states_from_another_address_are_heard_by_libfranka_and_by_us(tmp_path: Path, run_dir: Path) -> None:
    with twin_of("panda", tmp_path, states_from="127.77.7.7") as twin:
        reported = run(twin, PANDA + "end(moved=panda.move_to_joint_position([rad + 0.05 for rad in panda.q]))")
        assert reported["moved"]
        arm = Robot("panda", mode="real", port=twin.port)
        try:
            assert arm.connect_eagerly() is None
            goal = away(arm, 0.05)
            json_of(arm.send_action(goal))
            wait_at(arm, goal)
        finally:
            arm.cleanup()
