"""Test the twin's computer and body. The test controls the clock."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import pytest

from strands_actors.drivers.booster.protocol import IDLE, Command, CommandType, Fall, Motor
from strands_actors.drivers.booster.robots import TABLES, model_of
from strands_actors.drivers.booster.rpc import Api, Mode, Request
from strands_actors.drivers.booster.twin.onboard import Onboard
from strands_actors.drivers.booster.twin.simulated import BoosterBody
from strands_actors.drivers.common.physics.body import Commander

STEP_S = 0.002
LEFT_SHOULDER = 2
ELBOW = 4
KNEE = 14


class Twin:
    """An ``Onboard`` with a clock that the test advances."""

    def __init__(self, mode: Mode = Mode.WALKING) -> None:
        self.events: list[tuple[str, str]] = []
        self.onboard = Onboard(model_of("booster_t1"), lambda kind, text: self.events.append((kind, text)), mode)
        self.now_s = 100.0
        self.onboard.advance(self.now_s)
        self.home = self.onboard.state().q

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            self.onboard.advance(self.now_s)

    def ask(self, api: Api | int, **body: Any) -> int:
        return self.onboard.serve(Request("1", int(api), json.dumps(body))).status

    def command(self, slot: int, rad: float, count: int = 23) -> None:
        motors = [Motor(10, rad, 0.0, 0.0, 60.0, 3.0) if at == slot else IDLE for at in range(count)]
        self.onboard.command(Command(CommandType.PARALLEL, tuple(motors)))

    def read(self, api: Api, **body: Any) -> dict[str, Any]:
        answer = self.onboard.serve(Request("1", int(api), json.dumps(body)))
        assert answer.status == 0, answer
        result: dict[str, Any] = json.loads(answer.body)
        return result

    def transform(self, source: int, destination: int) -> tuple[list[float], list[float]]:
        """Return position (x, y, z) and orientation (w, x, y, z) of one of the vendor's frames in another one."""
        answer = self.read(Api.GET_FRAME_TRANSFORM, src=source, dst=destination)
        return [answer["position"][axis] for axis in "xyz"], [answer["orientation"][axis] for axis in "wxyz"]

    @property
    def q(self) -> Sequence[float]:
        return self.onboard.state().q


def test_the_table_is_that_of_the_robot() -> None:
    motors = model_of("booster_t1").motors
    assert [motor.slot for motor in motors] == list(range(23))
    assert [joint.slot for joint in model_of("booster_t1").joints] == list(range(2, 10))
    assert set(TABLES.robots) == {"booster_t1"}
    assert Twin().onboard.body.model.body_subtreemass[0] == pytest.approx(31.6, abs=0.1)


def test_it_stands_by_its_own_controller() -> None:
    twin = Twin()
    twin.run(4.0)
    assert twin.onboard.fall is Fall.IS_READY
    state = twin.onboard.state()
    assert max(abs(dq) for dq in state.dq) < 0.1
    assert state.acceleration[2] == pytest.approx(9.81, abs=0.3)


def test_the_robot_walks_as_commanded_and_keeps_its_velocity() -> None:
    twin = Twin()
    assert twin.ask(Api.MOVE, vx=0.5, vy=0.0, vyaw=0.0) == 0
    twin.run(2.0)
    assert twin.onboard.odometer.x_m == pytest.approx(1.0, abs=0.01), "the velocity never ends"
    assert float(twin.onboard.body.data.qpos[0]) == pytest.approx(1.0, abs=0.1), (
        "the body of the simulation has moved as far"
    )
    assert twin.ask(Api.MOVE, vx=0.0, vy=0.0, vyaw=0.5) == 0
    twin.run(1.0)
    assert twin.onboard.odometer.heading_rad == pytest.approx(0.5, abs=0.01)
    assert twin.ask(Api.MOVE, vx=0.0, vy=0.0, vyaw=0.0) == 0
    here = twin.onboard.odometer
    twin.run(0.5)
    assert twin.onboard.odometer == here and twin.onboard.fall is Fall.IS_READY


@pytest.mark.parametrize("mode", [Mode.DAMPING, Mode.PREPARE])
def test_it_walks_in_two_modes_only(mode: Mode) -> None:
    assert Twin(mode).ask(Api.MOVE, vx=0.1, vy=0.0, vyaw=0.0) == 502


def test_a_command_counts_only_while_the_upper_body_is_the_host_s() -> None:
    twin = Twin()
    twin.command(ELBOW, 0.5)
    twin.run(0.5)
    assert abs(twin.q[ELBOW]) < 0.05
    assert twin.ask(Api.UPPER_BODY, start=True) == 0
    twin.command(ELBOW, 0.5)
    twin.run(0.5)
    assert twin.q[ELBOW] == pytest.approx(0.5, abs=0.05)
    twin.run(2.0)
    assert twin.q[ELBOW] == pytest.approx(0.5, abs=0.05), "the arm keeps the last command"
    assert twin.ask(Api.UPPER_BODY, start=False) == 0
    twin.run(0.02)
    assert twin.q[ELBOW] > 0.4, "the robot moves the arm back slowly"
    twin.run(1.0)
    assert abs(twin.q[ELBOW]) < 0.05


def test_a_command_to_a_leg_is_not_obeyed() -> None:
    twin = Twin()
    twin.ask(Api.UPPER_BODY, start=True)
    twin.command(KNEE, 1.5)
    twin.run(1.0)
    assert twin.q[KNEE] == pytest.approx(0.4, abs=0.05) and twin.onboard.fall is Fall.IS_READY


def test_in_custom_mode_a_frame_for_the_arms_lets_the_legs_go() -> None:
    twin = Twin(Mode.CUSTOM)
    twin.run(0.5)
    assert twin.onboard.fall is Fall.IS_READY
    twin.command(ELBOW, 0.0)
    twin.run(2.0)
    assert twin.onboard.fall is not Fall.IS_READY


def test_it_falls_on_demand_lies_and_gets_up() -> None:
    twin = Twin()
    twin.ask(Api.UPPER_BODY, start=True)
    twin.ask(Api.MOVE, vx=0.5, vy=0.0, vyaw=0.0)
    twin.onboard.fall_over()
    assert twin.onboard.fall is Fall.IS_FALLING and not any(twin.onboard.twist)
    assert not twin.onboard.host_has_arms, "the robot uses its arms to get up"
    assert twin.ask(Api.UPPER_BODY, start=True) == 502 and twin.ask(Api.CHANGE_MODE, mode=2) == 502
    assert twin.ask(Api.GET_UP) == 409
    twin.run(2.0)
    assert twin.onboard.fall is Fall.HAS_FALLEN and twin.onboard.body.fallen
    assert twin.ask(Api.GET_UP) == 0
    twin.run(2.0)
    assert twin.onboard.fall is Fall.IS_READY and not twin.onboard.body.fallen
    assert twin.onboard.mode is Mode.WALKING
    falls = [text for kind, text in twin.events if kind == "fall"]
    assert falls == ["IS_FALLING", "HAS_FALLEN", "IS_GETTING_UP", "IS_READY"]


def test_in_damping_mode_it_sinks() -> None:
    twin = Twin()
    assert twin.ask(Api.CHANGE_MODE, mode=0) == 0
    twin.run(2.0)
    assert twin.onboard.body.fallen and twin.onboard.fall is Fall.IS_READY, (
        "the robot falls in damping mode and is ready to get up"
    )
    assert twin.ask(Api.CHANGE_MODE, mode=2) == 0
    twin.run(1.0)
    assert not twin.onboard.body.fallen


def test_its_head_turns() -> None:
    twin = Twin()
    assert twin.ask(Api.ROTATE_HEAD, pitch=0.3, yaw=-0.5) == 0
    twin.run(1.0)
    assert twin.q[1] == pytest.approx(0.3, abs=0.05) and twin.q[0] == pytest.approx(-0.5, abs=0.05)


@pytest.mark.parametrize(
    ("api", "body", "status"),
    [
        (Api.MOVE, {"vx": "fast"}, 400),
        (Api.MOVE, {"vx": 0.1}, 400),
        (Api.UPPER_BODY, {"start": 1}, 400),
        (Api.CHANGE_MODE, {"mode": 17}, 400),
        (Api.CHANGE_MODE, {}, 400),
        (2005, {}, 501),
        (Api.RESET_ODOMETRY, {}, 0),
        (Api.RESET_ODOMETRY, {"x": 1.0, "y": 2.0}, 400),
        (Api.RESET_ODOMETRY, {"x": 1.0, "y": 2.0, "theta": "north"}, 400),
        (Api.GET_FRAME_TRANSFORM, {"src": 0, "dst": 6}, 400),
        (Api.GET_FRAME_TRANSFORM, {"src": -1, "dst": 0}, 400),
        (Api.GET_FRAME_TRANSFORM, {"src": 0}, 400),
        (Api.GET_FRAME_TRANSFORM, {"src": True, "dst": 0}, 400),
        (Api.GET_MODE, {}, 0),
    ],
)
def test_the_answers_of_its_service(api: int, body: dict[str, Any], status: int) -> None:
    assert Twin().ask(api, **body) == status


def test_the_odometry_counts_on_from_the_pose_that_it_is_reset_to() -> None:
    twin = Twin()
    assert twin.ask(Api.RESET_ODOMETRY, x=1.0, y=2.0, theta=math.pi / 2) == 0
    assert twin.onboard.odometer == (1.0, 2.0, math.pi / 2)
    assert twin.ask(Api.MOVE, vx=0.5, vy=0.0, vyaw=0.0) == 0
    twin.run(1.0)
    x_m, y_m, heading_rad = twin.onboard.odometer
    assert (x_m, y_m, heading_rad) == pytest.approx((1.0, 2.5, math.pi / 2), abs=0.01)
    assert twin.ask(Api.RESET_ODOMETRY) == 0
    assert twin.onboard.odometer == (0.0, 0.0, 0.0)


BODY, HEAD, LEFT_HAND, RIGHT_HAND, LEFT_FOOT = range(5)
"""The vendor's frames."""


def test_a_frame_transform_follows_the_joints() -> None:
    twin = Twin()
    twin.run(0.1)
    position, orientation = twin.transform(BODY, BODY)
    assert position == pytest.approx([0.0] * 3) and orientation == pytest.approx([1.0, 0.0, 0.0, 0.0])
    assert twin.transform(HEAD, BODY)[0] == pytest.approx([0.0625, 0.0, 0.305], abs=0.005)
    (left, _), (right, _) = twin.transform(LEFT_HAND, BODY), twin.transform(RIGHT_HAND, BODY)
    assert left[1] > 0.1 and right == pytest.approx([left[0], -left[1], left[2]], abs=0.01)
    assert twin.transform(LEFT_FOOT, BODY)[0][2] < -0.5
    there, back = twin.transform(LEFT_HAND, BODY)[0], twin.transform(BODY, LEFT_HAND)[0]
    assert math.hypot(*there) == pytest.approx(math.hypot(*back))
    twin.ask(Api.UPPER_BODY, start=True)
    twin.command(LEFT_SHOULDER, -1.5)
    twin.run(1.5)
    assert twin.transform(LEFT_HAND, BODY)[0] != pytest.approx(left, abs=0.05), "the arm has moved"
    assert twin.transform(HEAD, BODY)[0] == pytest.approx([0.0625, 0.0, 0.305], abs=0.005)
    twin.ask(Api.ROTATE_HEAD, pitch=0.0, yaw=0.6)
    twin.run(1.5)
    _, turned = twin.transform(HEAD, BODY)
    assert 2.0 * math.atan2(turned[3], turned[0]) == pytest.approx(0.6, abs=0.05)


def test_the_devices_are_those_of_the_model() -> None:
    twin = Twin()
    assert twin.read(Api.GET_SENSORS)["imus"][0]["mount_position"] == "base"
    assert twin.read(Api.GET_HANDS) == {"hands": []}
    model = twin.read(Api.GET_ROBOT_MODEL)["robot_model"]
    assert model["root_link"] == model["links"][0]["name"] == "base"
    assert len(model["joints"]) == len(twin.q) == len(model["links"]) - 1
    assert sum(link["inertial"]["mass"] for link in model["links"]) == pytest.approx(
        float(sum(twin.onboard.body.model.body_mass))
    )
    shoulder = next(joint for joint in model["joints"] if joint["name"] == "left_shoulder_roll")
    assert (shoulder["parent_link"], shoulder["child_link"]) == ("left_shoulder_pitch", "left_shoulder_roll")
    assert shoulder["limit"]["lower"] < shoulder["limit"]["upper"] and shoulder["axis"] == {
        "x": 1.0,
        "y": 0.0,
        "z": 0.0,
    }


def test_the_simulation_has_the_arms_while_the_host_has_not() -> None:
    twin = Twin()
    body = BoosterBody(twin.onboard)
    assert set(body.commanders) == {Commander.NONE}
    body.energise(True)
    assert set(body.commanders) == {Commander.SIM}
    body.set_targets([0.0, -1.4, 0.5, -0.4, 0.0, 1.4, 0.0, 0.4])
    twin.run(1.0)
    assert body.felt().position[2] == pytest.approx(0.5, abs=0.05)
    assert twin.ask(Api.UPPER_BODY, start=True) == 0
    assert set(body.commanders) == {Commander.WIRE}
    body.set_targets([0.0, -1.4, 0.0, -0.4, 0.0, 1.4, 0.0, 0.4])
    twin.command(ELBOW, 0.5)
    twin.run(0.5)
    assert body.felt().position[2] == pytest.approx(0.5, abs=0.05), "the arm follows the wire"
