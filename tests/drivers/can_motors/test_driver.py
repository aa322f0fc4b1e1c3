"""The declarations of the driver: options, tables, conditions and gates."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.contract.driver import Candidate, GateState, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import Observation
from strands_actors.drivers import get_native_driver_class
from strands_actors.drivers.can_motors.driver import CanMotors
from strands_actors.drivers.can_motors.protocol import State
from strands_actors.drivers.can_motors.robots import TABLES, arm_of, model_table, table_of
from strands_actors.drivers.common.kinematics.chain import Chain
from strands_actors.drivers.common.kit.refusals import MotorCode
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .rig import ROBSTRIDE

NOW_NS = 10 * NS


def driver(robot: str = "openarm", **options: Any) -> CanMotors:
    buses = arm_of(robot, CanMotors.resolve(robot, options)["table"]).buses
    return CanMotors(robot, ",".join(f"can{bus}" for bus in range(buses)), CanMotors.resolve(robot, options))


def observation(made: CanMotors, **changes: Any) -> Observation:
    count = len(made.axes)
    sensors: dict[str, tuple[float, ...]] = {
        "motor_state": (1.0,) * count,
        "driver_temperature_c": (30.0,) * count,
        "rotor_temperature_c": (math.nan,) * count,
        "armed": (1.0,),
        **changes.pop("sensors", {}),
    }
    values: dict[str, Any] = {"position": (0.0,) * count, "stamp_ns": (NOW_NS,) * count, **changes}
    return Observation(t_ns=NOW_NS, sensors=sensors, **values)


def broken(made: CanMotors, seen: Observation) -> list[tuple[Any, SafeState | None, bool]]:
    checked = ((condition, condition.check(seen, NOW_NS)) for condition in made.conditions)
    return [(refusal.code, each.safe_state, each.always) for each, refusal in checked if refusal is not None]


def offer(made: CanMotors, action: dict[str, Any]) -> Refused | Candidate:
    seen = observation(made)
    state = GateState(NOW_NS, seen, seen.position, NOW_NS - round(0.004 * NS), True, 0.004)
    candidate = made.parse(action, state)
    if isinstance(candidate, Refused):
        return candidate
    return next((refusal for gate in made.gates if (refusal := gate(candidate, state)) is not None), candidate)


def code(result: Refused | Candidate) -> object:
    return result.code if isinstance(result, Refused) else None


def test_a_good_arm_breaks_no_condition() -> None:
    assert broken(driver(), observation(driver())) == []


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        (State.DISABLED, MotorCode.LIMP),
        (State.UNDERVOLTAGE, MotorCode.VOLTAGE),
        (State.HOT_MOTOR, MotorCode.TEMPERATURE),
        (State.LOST_COMMUNICATION, MotorCode.WATCHDOG),
        (State.OVERLOAD, MotorCode.FAULT),
    ],
)
def test_a_motor_without_torque_damps_the_others(state: State, expected: MotorCode) -> None:
    made = driver()
    states = (1.0, float(state), *(1.0,) * 6)
    assert broken(made, observation(made, sensors={"motor_state": states})) == [(expected, SafeState.DAMP, True)]
    # Before it is armed, no motor has torque.
    assert broken(made, observation(made, sensors={"motor_state": states, "armed": (0.0,)})) == []


def test_a_hot_motor_damps_the_arm() -> None:
    made = driver()
    hot = observation(made, sensors={"driver_temperature_c": (30.0, 81.0, *(30.0,) * 6)})
    assert broken(made, hot) == [(MotorCode.TEMPERATURE, SafeState.DAMP, True)]


@pytest.mark.parametrize(("on_silence", "safe_state"), [("damp", SafeState.DAMP), ("hold", SafeState.HOLD)])
def test_a_silent_motor_does_what_the_table_says(on_silence: str, safe_state: SafeState) -> None:
    made = driver("mine", table={**ROBSTRIDE, "on_silence": on_silence})
    old = NOW_NS - round(0.2 * NS)
    seen = observation(made, stamp_ns=(NOW_NS, old, NOW_NS))
    assert broken(made, seen) == [(Code.STALE, safe_state, on_silence == "damp")]


def test_gains_are_those_of_the_table() -> None:
    made, free = driver(), driver(gains_in_actions=True)
    action = {"joint_1": {"q": 0.001, "kp": 100.0}}
    assert code(offer(made, action)) == MotorCode.GAIN
    assert code(offer(free, action)) is None
    assert code(offer(free, {"joint_1": {"q": 0.001, "kp": 501.0}})) == MotorCode.GAIN
    assert code(offer(made, {"joint_1": {"q": 0.001, "tau": 1.0}})) is None
    assert code(offer(made, {"joint_1": {"q": 0.001, "tau": 41.0}})) == MotorCode.TOO_STRONG


def test_steps_and_ranges() -> None:
    made = driver()
    assert code(offer(made, {"joint_1": 0.009})) is None
    assert code(offer(made, {"joint_1": 0.02})) == Code.TOO_FAST
    assert code(offer(made, {"joint_4": -0.01})) == Code.PAST_TRAVEL
    # A setpoint that is late may step further, but not for long.
    seen = observation(made)
    for late_s, expected in ((0.02, None), (1.0, Code.TOO_FAST)):
        state = GateState(NOW_NS, seen, seen.position, NOW_NS - round(late_s * NS), True, 0.004)
        step = 2.0 * min(late_s, 0.04)
        candidate = made.parse({"joint_1": step}, state)
        assert isinstance(candidate, Candidate)
        assert code(next((r for gate in made.gates if (r := gate(candidate, state))), candidate)) == expected


def test_the_table_of_fallbacks() -> None:
    table = driver().fallbacks
    assert table[Reason.LEASE] is SafeState.HOLD
    assert {table[reason] for reason in (Reason.ESTOP, Reason.WIRE, Reason.ROOT, Reason.LINK)} == {SafeState.DAMP}
    assert table[Reason.STOP] is SafeState.LOWERED
    assert driver(on_exit="limp").fallbacks[Reason.CLEANUP] is SafeState.LIMP
    assert driver("mine", table=ROBSTRIDE).fallbacks[Reason.STOP] is SafeState.DAMP


@pytest.mark.parametrize(
    ("robot", "port", "options", "text"),
    [
        ("openarm", "can0,can1", {}, "Number of CAN buses of openarm: 1. Give can0"),
        ("bi_openarm", "can0", {}, "Number of CAN buses of bi_openarm: 2. Give can0,can1"),
        ("bi_openarm", "can0,can0", {}, "names one bus twice"),
        ("openarm", "can0:1", {}, "Give a CAN interface"),
        ("mine", "can0", {"table": ROBSTRIDE, "on_exit": "lower"}, "its table has no links and rest"),
        ("mine", "can0", {"table": ROBSTRIDE, "gravity_compensation": True}, "needs links in the table"),
        ("openarm", "can0", {"on_exit": "sit"}, "on_exit is 'sit'"),
        ("openarm", "can0", {"side": "top"}, "side is 'top'"),
    ],
)
def test_wrong_arguments_are_refused(robot: str, port: str, options: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        CanMotors(robot, port, CanMotors.resolve(robot, options)).check_port()


JOINT = ROBSTRIDE["joints"][0]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"motor": "dm1"}, "joint1 has the motor 'dm1'. Use one of dm3507"),
        ({"kp": 501.0}, "kp of joint1 is 501. A rs02 has 500 at most"),
        ({"torque": 18.0}, "torque of joint1 is 18"),
        ({"damp": 6.0}, "damp of joint1 is 6"),
        ({"low": 1.0}, "Give low < high"),
        ({"offset": 12.5}, "in the range"),
        ({"speed": 0.0}, "speed"),
        ({"colour": "red"}, "colour"),
        ({"id": 0}, "id"),
    ],
)
def test_a_wrong_entry_is_named(change: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=f"mine: the table is not accepted.*{text}"):
        arm_of("mine", {"joints": [{**JOINT, **change}]})


def test_two_motors_with_one_id() -> None:
    with pytest.raises(ValueError, match="two joints have the same id"):
        arm_of("mine", {"joints": [JOINT, {**JOINT, "key": "other"}]})
    with pytest.raises(ValueError, match="it has no joints"):
        arm_of("mine", {"joints": []})
    with pytest.raises(ValueError, match="rest has 2 numbers"):
        arm_of("mine", {"joints": [JOINT], "rest": [0.0, 1.0]})


def test_a_table_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "my_arm.toml"
    with pytest.raises(ValueError, match="cannot be read"):
        CanMotors.resolve("my_arm", {"table": str(file)})
    file.write_text(
        '[[joints]]\nkey = "a"\nmotor = "dm4310"\nid = 1\nlow = -1\nhigh = 1\nspeed = 1\ntorque = 1\nkp = 9\nkd = 1'
    )
    own: Any = Robot  # the stubs know the options of the robots that are declared
    own("my_table_arm", mode="real", port="can0", table=file)
    assert get_native_driver_class("my_table_arm") is CanMotors
    with pytest.raises(ValueError, match="my_other_arm"):
        Robot("my_other_arm", mode="real", port="can0")


def test_a_left_arm_is_the_mirror_of_a_right_one() -> None:
    points = {}
    for side in ("left", "right"):
        table = table_of("openarm", side)
        model = model_table(arm_of("openarm", table), table)
        keys = [joint["key"] for joint in table["joints"]]
        sign = 1 if side == "right" else -1
        # Axis 2 lifts the arm to its own side.
        points[side] = Chain(model, keys).points([0.0, sign * 0.8, 0.0, 0.6, 0.0, 0.0, sign * 0.2, 0.0])[-1]
    (x, y, z), (left_x, left_y, left_z) = points["right"], points["left"]
    assert (left_x, left_z) == pytest.approx((x, z), abs=0.03)
    assert left_y == pytest.approx(-y, abs=0.06)


@pytest.mark.parametrize("robot", TABLES.robots)
def test_the_weight_is_that_of_the_simulation(robot: str) -> None:
    import mujoco

    table = table_of(robot)
    arm = arm_of(robot, table)
    model = model_table(arm, table)
    plant = Plant.from_table(model)
    rad = [motor.low + 0.3 * (motor.high - motor.low) for motor in arm.motors]
    plant.data.qpos[plant._qpos] = rad
    mujoco.mj_forward(plant.model, plant.data)
    weight = Chain(model, [motor.key for motor in arm.motors]).gravity_nm(rad)
    assert weight == pytest.approx(plant.data.qfrc_bias[plant._dof].tolist(), abs=1e-6)
