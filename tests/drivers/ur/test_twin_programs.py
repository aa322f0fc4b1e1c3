"""Test programs on the twin's arm: ur-rtde's control script beyond joint moves, and URScript from clients."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

import numpy as np
import pytest

from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.twin import commands as c
from strands_actors.drivers.ur.twin import state_packets
from strands_actors.drivers.ur.twin.model import HOME_RAD
from strands_actors.drivers.ur.twin.outputs import Sample
from strands_actors.drivers.ur.twin.pose import frame_of
from tests.drivers.ur.world import COMMAND, World

FAR = (5.0, 5.0, 5.0, 0.0, 0.0, 0.0)


@pytest.fixture
def world() -> World:
    return World()


def lowered(pose: tuple[float, ...], metres: float) -> tuple[float, ...]:
    return (pose[0], pose[1], pose[2] - metres, *pose[3:])


def same(one: tuple[float, ...], other: tuple[float, ...], atol: float = 2e-3) -> bool:
    return np.allclose(np.array(frame_of(one)), np.array(frame_of(other)), atol=atol)


# -- the control script


def test_the_tool_goes_on_a_straight_line(world: World) -> None:
    world.start()
    start = world.tool
    world.command(c.Command.MOVE_L, *lowered(start, 0.2), 0.4, 1.0)
    seen = []
    for _ in range(20):
        world.run(0.1)
        seen.append(world.tool)
    assert world.answer == c.DONE
    assert same(world.tool, lowered(start, 0.2))
    assert all(math.dist(pose[:2], start[:2]) < 5e-3 for pose in seen), "the tool stays on the line"
    assert any(start[2] - 0.15 < pose[2] < start[2] - 0.05 for pose in seen), "the tool does not jump to the end"


def test_moves_by_pose_and_by_joints_arrive(world: World) -> None:
    world.start()
    goal = lowered(world.tool, 0.1)
    world.command(c.Command.MOVE_J_IK, *goal, 1.0, 2.0)
    world.run(1.5)
    assert world.answer == c.DONE and same(world.tool, goal)
    world.command(c.Command.NONE)
    world.command(c.Command.MOVE_L_FK, *HOME_RAD, 0.5, 1.0)
    world.run(1.5)
    assert world.answer == c.DONE and np.allclose(world.joints, HOME_RAD, atol=3e-3)
    world.command(c.Command.NONE)
    world.command(c.Command.SERVO_C, *goal, 0.5, 1.0, 0.0)
    world.run(1.5)
    assert world.answer == c.DONE and same(world.tool, goal)


def test_speed_servo_and_jog_lead_the_tool(world: World) -> None:
    world.start()
    start = world.tool
    world.command(c.Command.SPEED_L, 0, 0, -0.1, 0, 0, 0)
    world.run(1.0)
    assert math.isclose(world.tool[2], start[2] - 0.1, abs_tol=0.01)
    world.command(c.Command.SERVO_L, *start)
    world.run(1.0)
    assert same(world.tool, start)
    # feature 1: the axes of the tool, the third of which points away from the flange
    world.command(c.Command.JOG_START, 0, 0, 0.05, 0, 0, 0, 1.0, 0.5)
    world.run(1.0)
    ahead = frame_of(start).z
    gone = [now - was for now, was in zip(world.tool[:3], start[:3], strict=True)]
    assert np.allclose(gone, [0.05 * part for part in ahead], atol=5e-3)
    world.command(c.Command.JOG_STOP)
    world.run(0.5)
    assert world.answer == c.DONE
    stood = world.tool
    world.run(0.5)
    assert same(world.tool, stood)


def test_it_reckons_on_the_model(world: World) -> None:
    world.start()
    pose = world.tool
    assert same(world.ask(c.Command.GET_FORWARD_KINEMATICS), pose, 1e-3)
    longer = world.ask(c.Command.GET_FORWARD_KINEMATICS_OF, *HOME_RAD, 0, 0, 0.1, 0, 0, 0)
    assert math.isclose(math.dist(longer[:3], pose[:3]), 0.1, abs_tol=1e-3)
    assert np.allclose(world.ask(c.Command.GET_INVERSE_KINEMATICS, *pose), world.joints, atol=1e-4)
    near = (HOME_RAD[0] + 2 * math.pi - 1e-6, *HOME_RAD[1:])
    assert np.allclose(world.ask(c.Command.GET_INVERSE_KINEMATICS_NEAR, *pose, *near), near, atol=5e-3)
    assert world.ask(c.Command.POSE_TRANS, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0) == (1, 1, 0, 0, 0, 0)
    assert world.agrees(c.Command.HAS_INVERSE_KINEMATICS, *pose)
    assert not world.agrees(c.Command.HAS_INVERSE_KINEMATICS, *FAR)
    assert world.agrees(c.Command.IS_POSE_WITHIN_LIMITS, *pose)
    assert not world.agrees(c.Command.IS_POSE_WITHIN_LIMITS, *FAR)
    assert world.agrees(c.Command.ARE_JOINTS_WITHIN_LIMITS, *HOME_RAD)
    assert not world.agrees(c.Command.ARE_JOINTS_WITHIN_LIMITS, *[9.0] * 6)


def test_tool_and_payload_can_be_set_and_read(world: World) -> None:
    world.start()
    before = world.tool
    world.ask(c.Command.SET_TCP, 0, 0, 0.1, 0, 0, 0)
    assert world.ask(c.Command.GET_TCP_OFFSET) == (0, 0, 0.1, 0, 0, 0)
    assert math.isclose(math.dist(world.tool[:3], before[:3]), 0.1, abs_tol=1e-6)
    assert same(world.ask(c.Command.GET_INVERSE_KINEMATICS, *world.tool), tuple(world.joints), 1e-3)
    world.ask(c.Command.SET_PAYLOAD, 1.5, 0.01, 0.02, 0.03)
    assert (world.out("payload"), world.out("payload_cog")) == (1.5, (0.01, 0.02, 0.03))


def test_a_hand_moves_the_arm_in_freedrive_and_not_after(world: World) -> None:
    world.start()
    world.ask(c.Command.TEACH_MODE)
    plant = world.controller.plant
    plant.push([20.0, 0, 0, 0, 0, 0])
    world.run(0.3)
    pushed = world.pan
    assert pushed > 0.02
    status = world.out("robot_status_bits")
    assert isinstance(status, int) and status & c.STATUS_TEACH
    world.ask(c.Command.END_TEACH_MODE)
    world.run(0.5)
    stood = world.pan
    world.run(0.5)
    assert abs(world.pan - stood) < 0.01, "the servos hold against the same push"


def test_an_asynchronous_move_reports_its_end(world: World) -> None:
    world.start()
    progress = lambda: world.controller.int_out[COMMAND + 2]  # noqa: E731
    world.controller.write({f"input_int_register_{COMMAND + 1}": 1})
    world.command(c.Command.MOVE_J, 0.3, *HOME_RAD[1:], 1.0, 2.0)
    assert world.answer == c.DONE and progress() & 1 << 15
    world.run(2.0)
    assert not progress() & 1 << 15 and abs(world.pan - 0.3) < 5e-3


# -- force mode and contact


def press(world: World, wrench: Sequence[float], limits: Sequence[float] = (0.1,) * 6, kind: int = 2) -> None:
    """Send force mode with a frame that is turned by 90 degrees about x: its z is the base's -y."""
    whole = [kind, *(int(force != 0) for force in wrench)]
    values: dict[str, p.Value] = {f"input_int_register_{COMMAND + 1 + at}": word for at, word in enumerate(whole)}
    world.controller.write(values)
    world.command(c.Command.FORCE_MODE, 0, 0, 0, math.pi / 2, 0, 0, *wrench, *limits)


def test_force_mode_leads_the_tool_along_the_axes_that_give_way(world: World) -> None:
    world.start()
    start = world.tool
    press(world, (0, 0, 10.0, 0, 0, 0))
    assert world.answer == c.READY, "it is answered at once"
    world.run(1.0)
    gone = [now - was for now, was in zip(world.tool[:3], start[:3], strict=True)]
    assert gone[1] < -0.03 and np.allclose(gone, [0.0, gone[1], 0.0], atol=5e-3)
    press(world, (0, 0, -10.0, 0, 0, 0))
    world.run(1.0)
    assert math.isclose(world.tool[1], start[1], abs_tol=0.01), "the other force leads it back"
    world.command(c.Command.END_FORCE_MODE)
    world.run(0.5)
    assert world.answer == c.DONE
    stood = world.tool
    world.run(0.5)
    assert same(world.tool, stood)


def test_force_mode_keeps_its_limit_and_outlasts_a_stop(world: World) -> None:
    world.start()
    start = world.tool[1]
    press(world, (0, 0, 500.0, 0, 0, 0), (0.1, 0.1, 0.02, 0.1, 0.1, 0.1))
    world.run(1.0)
    assert math.isclose(world.tool[1], start - 0.02, abs_tol=4e-3)
    world.command(c.Command.STOP_L, 2.0)
    world.run(1.0)
    assert world.tool[1] < start - 0.025, "the thread of force mode goes on"


@pytest.mark.parametrize("damped", [False, True])
def test_the_damping_of_force_mode_slows_the_tool(world: World, damped: bool) -> None:
    world.start()
    if damped:
        world.command(c.Command.FORCE_MODE_DAMPING, 1.0)
    else:
        world.command(c.Command.FORCE_MODE_GAIN, 1.0)
    assert world.answer == c.DONE
    world.command(c.Command.NONE)
    start = world.tool[1]
    press(world, (0, 0, 5.0, 0, 0, 0))
    world.run(1.0)
    assert math.isclose(world.tool[1], start - (0.0 if damped else 0.05), abs_tol=5e-3)


def test_what_force_mode_does_not_simulate_ends_the_script(world: World) -> None:
    world.start()
    press(world, (0, 0, 5.0, 0, 0, 0), kind=1)
    assert world.controller.program is None and "force_mode of type 1 is not available" in world.controller.log[-1]
    world.start()
    press(world, (0, 0, 5.0, 0, 0, 0))
    world.command(c.Command.SERVO_J, *HOME_RAD)
    assert world.controller.program is None and "on top of force_mode" in world.controller.log[-1]


def test_the_tool_touches_nothing(world: World) -> None:
    world.start()
    world.controller.int_out[COMMAND + 1] = 7
    for number in (c.Command.START_CONTACT_DETECTION, c.Command.READ_CONTACT_DETECTION):
        world.command(c.Command.NONE)
        world.command(number, 0, 0, 1.0, 0, 0, 0)
        assert world.answer == c.DONE
    assert world.controller.int_out[COMMAND + 1] == 0
    world.controller.int_out[COMMAND + 1] = 7
    world.command(c.Command.TOOL_CONTACT, 0, 0, 1.0, 0, 0, 0)
    assert (world.answer, world.controller.int_out[COMMAND + 1]) == (c.READY, 0)


def test_a_motion_until_contact_ends_at_the_end_of_the_reach(world: World) -> None:
    world.start()
    world.command(c.Command.MOVE_UNTIL_CONTACT, 0, 0, 0.5, 0, 0, 0)
    world.run(0.5)
    assert world.answer == c.READY, "it is not done before a contact"
    world.run(5.0)
    assert world.controller.safety is p.SafetyMode.PROTECTIVE_STOP


@pytest.mark.parametrize("number", sorted(c.REFUSED))
def test_an_unsupported_call_ends_the_program_and_is_logged(world: World, number: int) -> None:
    world.start()
    world.command(number, *[0.1] * 18)
    assert world.controller.runtime_state == p.RuntimeState.STOPPED
    assert world.answer != c.DONE
    assert c.REFUSED[number] in world.controller.log[-1] and world.events == ["error"]


def test_where_it_cannot_get_is_an_error(world: World) -> None:
    world.start()
    world.command(c.Command.GET_INVERSE_KINEMATICS, *FAR)
    assert world.controller.runtime_state == p.RuntimeState.STOPPED and world.answer != c.DONE
    assert "runtime error" in world.controller.log[-1]
    for command in (c.Command.MOVE_L, c.Command.MOVE_J_IK, c.Command.SERVO_L):
        other = World()
        other.start()
        other.command(command, *FAR, 0.5, 0.5)
        assert other.controller.safety is p.SafetyMode.PROTECTIVE_STOP, command.name
    world.start()
    world.command(c.Command.SPEED_L, 0, 0, 1.0, 0, 0, 0)
    world.run(2.0)
    assert world.controller.safety is p.SafetyMode.PROTECTIVE_STOP, "the hand led the arm out of reach"
    stood = world.tool
    world.run(0.5)
    assert same(world.tool, stood)


def test_the_slider_slows_moves_and_counts_once(world: World) -> None:
    world.controller.write({"speed_slider_mask": 1, "speed_slider_fraction": 0.4})
    assert (world.out("speed_scaling"), world.out("target_speed_fraction")) == (1.0, 0.4)
    world.start()
    world.command(c.Command.MOVE_J, 0.4, *HOME_RAD[1:], 1.0, 40.0)
    world.run(0.5)
    assert 0.1 < world.pan < 0.25


def test_registers_are_reported_as_written(world: World) -> None:
    world.controller.write(
        {
            "input_int_register_5": -7,
            "input_double_register_6": 1.25,
            "input_bit_registers0_to_31": 0x80000001,
            "input_bit_registers32_to_63": 6,
            "input_bit_register_64": 1,
        }
    )
    assert world.out("input_int_register_5") == -7 and world.out("input_double_register_6") == 1.25
    assert world.out("input_bit_registers0_to_31") == 0x80000001
    assert world.out("input_bit_registers32_to_63") == 6
    assert world.out("input_bit_register_64") == 1 and world.out("input_bit_register_65") == 0


def test_the_layouts_of_the_text_ports_have_their_published_sizes(world: World) -> None:
    sample = Sample(world.controller)
    realtime = state_packets.realtime_message(world.controller, sample)
    assert len(realtime) == int.from_bytes(realtime[:4], "big") == 1220
    state = state_packets.state_message(world.controller, sample)
    assert len(state) == int.from_bytes(state[:4], "big") and state[4] == 16
    sizes, at = {}, 5
    while at < len(state):
        size = int.from_bytes(state[at : at + 4], "big")
        sizes[state[at + 4]] = size
        at += size
    assert sizes == {0: 47, 1: 251, 2: 37, 3: 75, 4: 101, 5: 225, 6: 445, 7: 61, 8: 9, 11: 26, 12: 8}
    angles = struct.unpack_from(">6d", realtime, 4 + 8 * 31)
    assert np.allclose(angles, world.joints)
    assert struct.unpack_from(">dd", state, 5 + 47 + 5)[0] == world.pan


def test_a_value_for_several_clients_is_computed_once(world: World) -> None:
    sample = Sample(world.controller)
    assert sample["actual_TCP_pose"] is sample["actual_TCP_pose"]
    assert list(sample) == ["actual_TCP_pose"], "the sample has only this field"


# -- programs of text


def test_a_line_moves_the_arm_and_its_program_ends(world: World) -> None:
    world.text(f"movej([0.3,{','.join(map(str, HOME_RAD[1:]))}], a=2, v=1)\n", 0.2)
    assert world.controller.runtime_state == p.RuntimeState.PLAYING
    world.run(1.5)
    assert world.controller.runtime_state == p.RuntimeState.STOPPED
    assert abs(world.pan - 0.3) < 5e-3
    start = world.tool
    world.text(f"movel(p[{','.join(map(str, lowered(start, 0.1)))}], a=1.2, v=0.25)\n", 2.0)
    assert same(world.tool, lowered(start, 0.1)) and world.controller.program is None
    world.text("speedl([0,0,0.1,0,0,0], 1.2, 0.5)\n", 2.0)
    assert math.isclose(world.tool[2], start[2] - 0.05, abs_tol=0.01)


def test_lines_set_the_named_values(world: World) -> None:
    world.text("set_digital_out(2,True)\n")
    assert world.out("actual_digital_output_bits") == 4 and world.controller.program is None
    world.text("digital_out[3]=True\n")
    world.text("set_tcp(p[0,0,0.1,0,0,0])\n")
    world.text("set_payload(1.2, (0,0,0.05))\n")
    world.text("set_tool_voltage(24)\n")
    world.text("sec note():\n  set_standard_digital_out(0, True)\nend\n")
    assert world.out("actual_digital_output_bits") == 13
    assert world.controller.tcp.place == (0, 0, 0.1)
    assert (world.out("payload"), world.out("tool_output_voltage")) == (1.2, 24)


def test_a_program_counts_decides_and_calls(world: World) -> None:
    world.text(
        """
def count():
  def add(step):
    total = total + step  # of the caller
  end
  global total = 0
  global n = 0
  while n < 5:
    n = n + 1
    if n == 2:
      continue
    elif n == 4:
      add(100)
    else:
      add(n)
    end
    sync()
  end
  write_output_integer_register(3, total)
  textmsg("total ", total)
  sleep(0.1)
  write_output_boolean_register(64, True)
end
""",
        0.5,
    )
    assert list(world.controller.log) == ["total 109"]
    assert world.out("output_int_register_3") == 109 and world.out("output_bit_register_64") == 1
    assert world.controller.program is None


def test_a_loop_without_waits_does_not_block_the_controller(world: World) -> None:
    world.text("def forever():\n  while True:\n    x = 1\n  end\nend\n")
    assert world.controller.runtime_state == p.RuntimeState.PLAYING
    world.text("stopj(2)\n")
    assert world.controller.program is None


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("movej([0,0,0\n", "compile error: line 1: syntax error"),
        ("def f():\n  while True:\n  sync()\nend\n", "compile error: line 4: an end is missing"),
        ("def f():\n  thread t():\n  end\nend\n", "compile error: line 2: thread"),
        ("force_mode(p[0,0,0,0,0,0])\n", "runtime error: force_mode is not available"),
        ("__import__('os')\n", "runtime error: __import__ is not available"),
        ("_set_bit(1, 8, 0, True)\n", "runtime error: _set_bit is not available"),
        ("x = (1).real\n", "runtime error: an expression"),
        ("movej([0,0,0,0,0])\n", "runtime error: six numbers"),
        ("movej([0,0,9,0,0,0])\n", "protective stop: a joint is to go beyond its range"),
        ("x = 1 / 0\n", "runtime error: line 1: division by zero"),
        ("x = [1] * 99999999999\n", "runtime error: line 1: both sides of an arithmetic operator must be numbers"),
        ("set_tcp()\n", "runtime error: line 1: missing a required argument"),
        ("set_digital_out(99, True)\n", "runtime error: 99 is not one of 0 to 17"),
        ("x = y\n", "runtime error: y is not defined"),
        ("break\n", "runtime error: break"),
        ("if True:\n" * 3000 + "end\n" * 3000, "compile error"),
        ("def f():\n  x = 3\n  while True:\n    x = x * x\n  end\nend\n", "a number too large"),
    ],
)
def test_unknown_lines_are_logged_and_move_nothing(world: World, text: str, why: str) -> None:
    world.text(text)
    assert world.controller.program is None
    assert why in world.controller.log[-1]
    assert np.allclose(world.joints, HOME_RAD, atol=1e-3)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("freedrive_mode([1, 0, 0, 0, 0, 0])", "along some axes only"),
        ('popup("look", blocking=True)', "a blocking popup"),
        ("signal_async_progress(5)", "signal_async_progress"),
    ],
)
def test_an_argument_that_has_no_effect_here_ends_the_program(world: World, line: str, reason: str) -> None:
    world.text(f"{line}\n")
    assert world.controller.program is None and not world.controller.motion.limp
    assert "not available" in world.controller.log[-1] and reason in world.controller.log[-1]


def test_freedrive_of_ur_rtde_is_along_all_axes(world: World) -> None:
    for axes, limp in (((1, 1, 1, 1, 1, 1), True), ((1, 1, 1, 0, 0, 0), False)):
        world.start()
        world.controller.write({f"input_int_register_{COMMAND + 1 + at}": one for at, one in enumerate(axes)})
        world.command(c.Command.FREEDRIVE)
        assert world.controller.motion.limp is limp
    assert "along some axes only" in world.controller.log[-1] and world.controller.program is None
