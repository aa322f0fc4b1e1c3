"""The refusals of ``Robot(...)`` with their texts, before any process is started, and its registry."""

from __future__ import annotations

import inspect
from types import SimpleNamespace
from typing import Any

import pytest
from serial.tools import list_ports

import strands_actors
from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot, SimRobot
from strands_actors.caller.resolve.wanted import read as factory_keywords
from strands_actors.drivers import HardwareDriver, register_native_driver, register_robot

PORT = {"mode": "real", "port": "/dev/ttyACM0"}
TWIN = {"mode": "real", "transport": "twin"}

KEYWORDS = (
    "It takes baud, baud_rate, calibration, cameras, data_config, id, lower_s, max_jump, max_relative_target, "
    "mesh, motor_ids, on_exit, port, require_drill, rest, sim, timeout, tool_name, transport"
)
SERVOS = "Give 6 different ids, 0 to 252, in the order shoulder_pan, shoulder_lift, elbow_flex, wrist_flex"

REFUSALS: list[tuple[str, dict[str, Any], tuple[str, ...]]] = [
    ("so10", PORT, ("'so10' is not known", "Did you mean: so10", "list_robots()")),
    ("toaster", PORT, ("'toaster' is not known", "list_robots()")),
    ("toaster", {}, ("'toaster' is not known", "list_robots()")),
    (
        "so101_leader",
        PORT,
        ("so101_leader is a teleoperator", "its follower is Robot('so101', mode='real', port=...)"),
    ),
    ("ability_hand", PORT, ("ability_hand has no native driver", "hope_jr", "so100, so101")),
    ("ability_hand", {}, ("ability_hand has no native driver", "hope_jr", "so100, so101")),
    ("omx", PORT, ("omx is driven by LeRobot's own class", "not installed", "pip install 'lerobot[dynamixel]'")),
    ("omx", {**PORT, "driver": "strands"}, ("omx has no native driver", "hope_jr", "so100, so101")),
    (
        "so101",
        {**PORT, "driver": "lerobot"},
        ("so101 is driven by LeRobot's own class", "pip install 'lerobot[feetech]'"),
    ),
    ("so101", {**PORT, "driver": "magic"}, ("driver is 'magic'", "'auto', 'lerobot', 'strands'")),
    ("so101", {"driver": "magic"}, ("driver is 'magic'", "'auto', 'lerobot', 'strands'")),
    ("so101", {"mode": "real", "prot": "x"}, ("no 'prot'", "'prot' -> 'port'", "Feetech", KEYWORDS)),
    ("so101", {"prot": "x"}, ("no 'prot'", "'prot' -> 'port'", "Feetech", KEYWORDS)),
    ("so101", {**PORT, "wheels": 4}, ("no 'wheels'", KEYWORDS)),
    ("so101", {**PORT, "cameras": {"top": 0}}, ("camera 'top' is 0", "Give its settings")),
    ("so101", {"mode": "real", "transport": "smoke"}, ("no transport 'smoke'", "It offers twin")),
    ("so101", {**PORT, "sim": 1}, ("sim=", "Add it, or leave out sim=", "FeetechDriver offers twin")),
    ("so101", {**TWIN, "sim": "so101"}, ("sim is 'so101'", "Robot('so101')")),
    ("so101", {**TWIN, "port": "/dev/ttyACM0"}, ("port='/dev/ttyACM0'", "transport='twin'", "Give one of them")),
    ("so101", {**PORT, "tool_name": "my arm"}, ("tool_name is 'my arm'", "1 to 64 of A-Z a-z 0-9 _ -")),
    ("so101", {**PORT, "tool_name": "a" * 65}, ("tool_name is",)),
    ("so101", {**PORT, "tool_name": ""}, ("tool_name is ''",)),
    ("so101", {**PORT, "tool_name": "arm\n"}, ("tool_name is",)),
    ("so101", {"tool_name": "my arm"}, ("tool_name is 'my arm'",)),
    ("so101", {"id": "my arm"}, ("id is 'my arm'", "1 to 64 of A-Z a-z 0-9 _ -")),
    ("so101", {"peer_id": "my arm"}, ("peer_id is 'my arm'",)),
    ("so101", {"id": 7}, ("id is 7",)),
    ("so101", {"id": "left", "tool_name": "right"}, ("id and tool_name are both given", "Give one of them")),
    ("so101", {"id": "left", "peer_id": "right"}, ("id and peer_id are both given",)),
    ("so101", {"mode": "dream", "port": "x"}, ("mode is 'dream'", "'sim', 'real', 'auto'", "upper or lower case")),
    ("so101", {"mode": None}, ("mode is None", "'sim', 'real', 'auto'")),
    ("so101", {**PORT, "baud": 9600}, ("baud is 9600", "1000000, 500000")),
    ("so101", {**PORT, "baud_rate": 9600}, ("baud is 9600", "1000000, 500000")),
    (
        "so101",
        {**PORT, "baud": 1_000_000, "baud_rate": 1_000_000},
        ("baud and baud_rate are both given", "Give one of them"),
    ),
    ("so101", {**PORT, "motor_ids": (1, 2)}, ("motor_ids is (1, 2)", SERVOS)),
    ("so101", {**PORT, "motor_ids": (1, 2, 3, 4, 5, 5)}, ("motor_ids is", SERVOS)),
    ("so101", {**PORT, "motor_ids": (1, 2, 3, 4, 5, 253)}, ("motor_ids is", SERVOS)),
    ("so101", {**PORT, "motor_ids": (1, 2, 3, 4, 5, True)}, ("motor_ids is", SERVOS)),
    ("so101", {**PORT, "motor_ids": "123456"}, ("motor_ids is '123456'", SERVOS)),
    ("so101", {**PORT, "timeout": 0}, ("timeout is 0. Give seconds, 0.1 to 10",)),
    ("so101", {**PORT, "timeout": float("nan")}, ("timeout is nan",)),
    ("so101", {"mode": "real", "transport": "serial"}, ("so101 needs 'port'",)),
    ("ur5e", {"mode": "real", "transport": "serial"}, ("URDriver has no transport 'serial'. It offers twin",)),
    ("ur5e", {**PORT, "control_frequency": 5}, ("control_frequency is 5", "10 to 500", "default 125")),
    ("ur5e", {**PORT, "control_frequency": True}, ("control_frequency is True",)),
    ("ur5e", {**PORT, "model": "ur10e"}, ("model is 'ur10e'. Use Robot('ur10e')",)),
    ("so101", {**PORT, "calibration": 7}, ("calibration is 7", "Give a path, a dict or None")),
    ("ur5e", {"mode": "real"}, ("ur5e needs 'port', its address", "Robot('ur5e', mode='real', port=")),
    ("", {}, ("the name is ''",)),
]

WRONG_TYPES: list[tuple[Any, dict[str, Any], str]] = [
    (None, {}, "the name is None. Give the name of a robot as text: list_robots() has them all"),
    (7, PORT, "the name is 7"),
    ("so101", {"mesh": "yes"}, "mesh is 'yes'. Give MeshConfig"),
    ("so101", {"mode": "real", "at": []}, "at is []. Give the address of the robot's host: 'tls/arm.example:7447'"),
    ("so101", {"mode": "real", "at": 5}, "at is 5. Give the address of the robot's host"),
    ("so101", {"mode": "real", "at": True}, "at is True. Give the address of the robot's host"),
    ("so101", {"mode": "real", "at": b"x"}, "at is b'x'. Give the address of the robot's host"),
    ("so101", {**PORT, "mesh": "tcp/0.0.0.0:7447"}, "mesh is 'tcp/0.0.0.0:7447'. Give MeshConfig"),
]


@pytest.mark.parametrize(("name", "keywords", "text"), WRONG_TYPES)
def test_an_argument_of_a_wrong_type_is_refused(name: Any, keywords: dict[str, Any], text: str) -> None:
    with pytest.raises(TypeError) as refusal:
        Robot(name, **keywords)
    assert text in str(refusal.value)


@pytest.mark.parametrize(
    ("written", "robot"),
    [("so-101", "so101"), ("SO101", "so101"), ("robotiq", "robotiq_2f85"), ("Unitree G1", "unitree_g1")],
)
def test_a_name_is_known_in_any_spelling(written: str, robot: str) -> None:
    made = Robot(written, mode="real", port="192.0.2.10" if "G1" in written else "x", mesh=False)
    assert (made.tool_name, made.driver.robot) == (robot, robot)


@pytest.mark.parametrize("name", ["so101", "koch"])
def test_the_servo_keywords_of_the_page_are_used(name: str) -> None:
    usual = Robot(name, mode="real", port="x").driver
    ids = tuple(10 + motor_id for motor_id in usual.ids)
    keywords = {"baud_rate": 1_000_000, "motor_ids": ids, "timeout": 1.0, "transport": "serial"}
    arm = Robot(name, mode="real", port="x", **keywords)
    assert (arm.driver.ids, arm.transport) == (ids, None)
    assert arm.driver.config.timeout_s == 1.0
    assert Robot(name, mode="real", port="x", motor_ids=()).driver.ids == usual.ids
    with pytest.raises(TypeError, match=r"a simulation of .* would ignore transport="):
        Robot(name, transport="serial")


def test_a_ur_accepts_its_model_and_control_frequency() -> None:
    arm = Robot("ur5e", mode="real", port="192.0.2.7", model="UR5e", control_frequency=25)
    assert getattr(arm.driver, "period_s") == 0.04  # noqa: B009


def test_the_signature_shows_every_keyword_of_the_factory() -> None:
    taken = inspect.signature(factory_keywords).parameters
    shown = inspect.signature(Robot).parameters
    keywords = {name: one.default for name, one in taken.items() if one.kind is one.KEYWORD_ONLY}
    assert {name: shown[name].default for name in keywords} == keywords
    assert {"approve", "guarded", "approve_within_s", "options"} <= set(shown)


def test_dir_shows_the_public_names_and_the_verbs_of_a_robot() -> None:
    assert dir(strands_actors) == sorted({*strands_actors.__all__, "__version__"})
    for name in dir(strands_actors):
        assert getattr(strands_actors, name) is not None
    assert {"release_sport_mode", "send_action", "stop"} <= set(dir(Robot("go2", mode="real", port="192.0.2.7")))
    assert "step" in dir(Robot("so101"))
    assert "release_sport_mode" not in dir(Robot("so101"))


def test_a_robot_is_a_hardware_driver_of_the_page() -> None:
    assert isinstance(Robot("so101"), HardwareDriver)
    assert not isinstance(object(), HardwareDriver)


@pytest.mark.parametrize(("name", "keywords", "texts"), REFUSALS)
def test_a_wrong_argument_is_refused_with_the_accepted_ones(
    name: str, keywords: dict[str, Any], texts: tuple[str, ...]
) -> None:
    with pytest.raises(ValueError) as refusal:
        Robot(name, **keywords)
    for text in texts:
        assert text in str(refusal.value)


@pytest.mark.parametrize(
    "keywords",
    [
        {"port": "/dev/ttyACM0"},
        {"mode": "SIM", "port": "/dev/ttyACM0"},
        {"transport": "twin"},
        {"baud": 1_000_000},
        {"calibration": "arm.json"},
    ],
)
def test_what_a_simulation_would_ignore_is_refused(keywords: dict[str, Any]) -> None:
    with pytest.raises(TypeError) as refusal:
        Robot("so101", **keywords)
    ignored = next(key for key in keywords if key != "mode")
    assert str(refusal.value) == (
        f"Robot: a simulation of so101 would ignore {ignored}=. Add mode='real', or leave it out"
    )


def test_a_twin_needs_a_simulation_of_the_same_robot() -> None:
    sim = Robot("so100")
    with pytest.raises(ValueError, match=r"sim is a simulation of so100\. Give a simulation of so101"):
        Robot("so101", **TWIN, sim=sim)
    arm = Robot("so_arm100", **TWIN, sim=sim)
    assert arm.twin_process is sim.twin_process
    with pytest.raises(ValueError, match=r"sim is <Robot so100 \(so100, twin\)>"):
        Robot("so100", **TWIN, sim=arm)  # the wire of the simulation is in use


# -- the mode


@pytest.fixture
def plugged(monkeypatch: pytest.MonkeyPatch) -> list[SimpleNamespace]:
    """The serial devices that this machine reports."""
    devices: list[SimpleNamespace] = []
    monkeypatch.setattr(list_ports, "comports", lambda: devices)
    return devices


def bus_adapter(path: str) -> SimpleNamespace:
    return SimpleNamespace(device=path, vid=0x1A86, pid=0x55D3)


def test_without_a_mode_a_robot_is_simulated(plugged: list[SimpleNamespace]) -> None:
    plugged.append(bus_adapter("/dev/ttyACM0"))  # it is ignored
    sim = Robot("so101")
    assert isinstance(sim, SimRobot)
    assert repr(sim) == "<Robot so101 (so101, sim)>"
    assert not isinstance(Robot("so101", **PORT), SimRobot)


def test_auto_is_real_where_exactly_one_robot_is_connected(plugged: list[SimpleNamespace]) -> None:
    def made(**keywords: Any) -> str:
        return repr(Robot("so101", "Auto", **keywords))

    plugged.append(SimpleNamespace(device="/dev/ttyS0", vid=None, pid=None))
    assert made() == "<Robot so101 (so101, sim)>"
    assert made(port="/dev/ttyS0") == "<Robot so101 (so101, /dev/ttyS0)>"
    assert made(transport="twin") == "<Robot so101 (so101, twin)>"
    plugged.append(bus_adapter("/dev/ttyACM0"))
    assert made() == "<Robot so101 (so101, /dev/ttyACM0)>"
    plugged.append(bus_adapter("/dev/ttyACM1"))
    assert made() == "<Robot so101 (so101, sim)>"  # with two devices the choice is ambiguous
    assert repr(Robot("ur5e", "auto")) == "<Robot ur5e (ur5e, sim)>"
    assert repr(Robot("ur5e", "auto", port="192.0.2.1")) == "<Robot ur5e (ur5e, 192.0.2.1)>"


def test_close_names_are_offered() -> None:
    with pytest.raises(ValueError, match=r"Did you mean: .*so101"):
        Robot("so-110", mode="real", port="x")


@pytest.mark.parametrize(
    ("devices", "text"),
    [
        (
            [bus_adapter("/dev/ttyUSB1"), bus_adapter("/dev/ttyACM0")],
            "Serial devices here: /dev/ttyACM0, /dev/ttyUSB1 (",
        ),
        ([SimpleNamespace(device="/dev/ttyS0")], "Serial devices here: /dev/ttyS0, none looks like a servo bus"),
        ([], "Serial devices here: none"),
    ],
)
def test_the_refusal_of_a_missing_port_names_the_serial_devices(
    plugged: list[SimpleNamespace], devices: list[SimpleNamespace], text: str
) -> None:
    plugged += devices
    with pytest.raises(ValueError) as refusal:
        Robot("so101", mode="real")
    for part in ("so101 needs 'port'", "port='/dev/ttyACM0'", text, "a path is not an identity"):
        assert part in str(refusal.value)


@pytest.mark.parametrize("keyword", ["id", "tool_name", "peer_id"])
def test_the_id_of_a_robot_has_the_names_of_lerobot_and_of_strands_robots(keyword: str) -> None:
    for made in (Robot("so101", **{keyword: "left"}), Robot("so101", **PORT, **{keyword: "left"}, mesh=False)):
        assert made.id == made.tool_name == made.name == made.peer_id == "left"
    assert Robot("so101", id="left", tool_name="left").id == "left", "the same id may be given twice"
    assert Robot("so101").id == "so101"


def test_a_robot_can_be_made_by_any_of_its_names_and_starts_nothing() -> None:
    arm = Robot("so101_follower", mode="REAL", port="/dev/nowhere", tool_name="left")
    assert (arm.tool_name, arm.name, arm.tool_type) == ("left", "left", "robot")
    assert repr(arm) == "<Robot left (so101, /dev/nowhere)>"
    assert arm.tree() is None
    assert Robot("so101", mode="real", port="x").tool_name == "so101"
    assert Robot("so101", mode="real", port="x", data_config="so101_tri").data_config == "so101_tri"
    assert isinstance(arm, RealRobot)


# -- a driver class of the drivers page


class Lamp:
    """A driver class with all members, which do nothing."""

    PORT_KIND = "address"
    TRANSPORTS = ("usb",)
    action_features = ("brightness",)
    tool_name = ""
    tool_type = "robot"
    tool_spec: dict[str, Any] = {}  # noqa: RUF012

    def __init__(
        self, tool_name: str, cameras: Any = None, data_config: Any = None, port: str = "", transport: str = ""
    ) -> None: ...

    def nothing(self) -> None: ...

    cleanup = get_status = get_task_status = run_policy = send_action = nothing
    stop = stop_task = stream = nothing


def test_a_users_driver_class_runs_as_a_tree_with_its_own_keywords() -> None:
    register_robot("lamp")
    register_native_driver("lamp", Lamp)
    lamp = Robot(
        "lamp", mode="real", port="192.0.2.7", tool_name="left", data_config="bright", guarded=("move_to",)
    )
    assert isinstance(lamp, RealRobot)
    assert (lamp.tool_name, lamp.data_config, lamp.driver.axes) == ("left", "bright", ("brightness",))
    expected = {"tool_name": "left", "port": "192.0.2.7", "data_config": "bright"}
    assert lamp.driver.config.keywords == expected
    over_usb = Robot("lamp", mode="real", transport="usb")
    assert over_usb.driver.config.keywords == {"tool_name": "lamp", "transport": "usb"}
    for keywords, text in (
        ({}, "Lamp has no simulation of lamp. Use mode='real'"),
        ({"mode": "real"}, "lamp needs 'port'"),
        ({"mode": "real", "prot": "x"}, r"no 'prot' \('prot' -> 'port'\?\). It takes cameras, data_config, port"),
        ({"mode": "real", "port": "x", "cameras": {"top": 0}}, "Lamp opens no cameras"),
        ({"mode": "real", "transport": "twin"}, "no simulated robot for Lamp. Give the port"),
        ({"mode": "real", "transport": "smoke"}, "no transport 'smoke'. It offers usb"),
        (
            {"mode": "real", "port": "x", "data_config": object()},
            "data_config is .* which cannot be sent to the process of Lamp",
        ),
        ({"mode": "real", "port": "x", "require_drill": "soon"}, "require_drill is 'soon'"),
    ):
        with pytest.raises(ValueError, match=text):
            Robot("lamp", **keywords)


def test_a_class_registered_for_an_alias_of_a_known_robot_drives_the_robot() -> None:
    with pytest.raises(
        ValueError, match=r"koch_follower \(koch\) already has the driver DynamixelDriver. Pass overwrite"
    ):
        register_native_driver("koch_follower", Lamp)
    register_native_driver("koch_follower", Lamp, overwrite=True)
    for name in ("koch", "koch_follower", "Koch"):
        arm = Robot(name, mode="real", port="/dev/ttyUSB0")
        assert arm.driver.config.name == "Lamp"
        with pytest.raises(ValueError, match="Lamp has no simulation of"):
            Robot(name)


@pytest.mark.parametrize("word", ["real", "REAL", " real "])
def test_the_environment_variable_decides_the_mode_auto(
    monkeypatch: pytest.MonkeyPatch, plugged: list[SimpleNamespace], word: str
) -> None:
    monkeypatch.setenv("STRANDS_ROBOT_MODE", word)
    with pytest.raises(ValueError, match="so101 needs 'port'"):
        Robot("so101", "auto")
    plugged.append(bus_adapter("/dev/ttyACM0"))
    assert repr(Robot("so101", "auto")) == "<Robot so101 (so101, /dev/ttyACM0)>"
    assert repr(Robot("so101")) == "<Robot so101 (so101, sim)>", "without a mode, Robot() never uses hardware"
    monkeypatch.setenv("STRANDS_ROBOT_MODE", "sim")
    assert repr(Robot("so101", " Auto ")) == "<Robot so101 (so101, sim)>"


def test_an_invalid_value_of_the_environment_variable_is_ignored_and_reported(
    monkeypatch: pytest.MonkeyPatch, plugged: list[SimpleNamespace], caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("STRANDS_ROBOT_MODE", "auto")
    assert repr(Robot("so101", "auto")) == "<Robot so101 (so101, sim)>"
    assert caplog.text == ""
    monkeypatch.setenv("STRANDS_ROBOT_MODE", "rael")
    assert repr(Robot("so101", "auto")) == "<Robot so101 (so101, sim)>"
    assert "STRANDS_ROBOT_MODE is 'rael', and is ignored" in caplog.text


def test_a_simulation_has_the_gripper_of_its_arm_and_no_other() -> None:
    plain, gripping = Robot("ur5e"), Robot("ur5e", gripper="robotiq_2f85")
    with pytest.raises(ValueError, match="gripper is 'robotiq_2f85', and None in the simulation"):
        Robot("ur5e", mode="real", transport="twin", sim=plain, gripper="robotiq_2f85")
    with pytest.raises(ValueError, match="gripper is None"):
        Robot("ur5e", mode="real", transport="twin", sim=gripping)
    assert Robot("ur5e", mode="real", transport="twin", sim=gripping, gripper="robotiq_2f85").transport == "twin"
    with pytest.raises(ValueError, match="gripper"):
        Robot("ur5e", gripper="hand")
    with pytest.raises(TypeError, match="would ignore control_frequency="):
        Robot("ur5e", control_frequency=100.0)
