"""Behaviours of the factory and the registry that the tests of strands-robots require, tested through the
public names without a robot.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from strands_actors import (
    HardwareDriver,
    Robot,
    list_driver_coverage,
    list_native_drivers,
    list_robots,
    register_native_driver,
    register_robot,
)
from strands_actors.drivers import (
    DRIVER_CHOICES,
    DRIVER_SURFACE,
    canonical_name,
    get_native_driver_class,
    resolve_driver,
)

from .own_models import write_mjcf

ARM = {"mode": "real", "port": "/dev/ttyACM0"}
GRIPPER = {"mode": "real", "port": "192.0.2.20"}
UR = {"mode": "real", "port": "192.0.2.30"}
G1 = {"mode": "real", "port": "192.168.123.161"}
NAN = float("nan")


class Half:
    """A class with too few members for a driver."""

    SUPPORTED_ROBOTS = ("half_robot",)


@pytest.mark.parametrize(
    ("robot", "keywords", "says"),
    [
        ("so101", {"driver": "vendor"}, "vendor"),
        ("so101", {**ARM, "driver": "vendor"}, "vendor"),
        ("so101", {**ARM, "transport": "carrier"}, "'carrier'. It offers twin, serial"),
        ("ur5e", {"mode": "real", "transport": "carrier"}, "'carrier'. It offers twin$"),
        ("so101", {"baud_rate": 1_000_000}, "baud"),
        ("ability_hand", {**ARM, "driver": "strands"}, "ability_hand"),
        ("robotiq_2f85", {**GRIPPER, "unit_id": 300}, "unit_id"),
        ("robotiq_2f85", {**GRIPPER, "stroke_mm": 0}, "stroke_mm"),
        ("robotiq_2f85", {**GRIPPER, "speed": "fast"}, "speed"),
        ("ur5e", {**UR, "control_frequency": 0}, "control_frequency"),
        ("ur5e", {**UR, "control_frequency": float("inf")}, "control_frequency"),
        ("ur5e", {**UR, "control_frequency": True}, "control_frequency"),
        (
            "ur5e",
            {**UR, "model": "ur99"},
            "model is 'ur99'. Give 'ur5e', or leave model out. Models are ur3e, ur5e",
        ),
        ("ur5e", {**UR, "model": "UR10e"}, r"Use Robot\('ur10e'\), or leave model out"),
        ("unitree_g1", {**G1, "battery_floor_pct": NAN}, "battery_floor_pct"),
        ("unitree_g1", {**G1, "battery_floor_pct": 101}, "battery_floor_pct"),
        ("unitree_g1", {**G1, "battery_floor_pct": True}, "battery_floor_pct"),
        ("so101", {**ARM, "timeout": 0}, "timeout"),
        ("so101", {**ARM, "motor_ids": (1, 1)}, "motor_ids"),
        ("so101", {**ARM, "motor_ids": (0, 254)}, "motor_ids"),
    ],
)
def test_invalid_options_are_refused_when_the_robot_is_made(
    robot: str, keywords: dict[str, Any], says: str
) -> None:
    with pytest.raises((ValueError, TypeError), match=says):
        Robot(robot, **keywords)


def test_the_registry_and_the_list_of_robots_agree() -> None:
    assert set(list_native_drivers()) <= set(list_robots())
    assert get_native_driver_class("g1") is get_native_driver_class("unitree_g1")
    assert {resolve_driver(robot) for robot in list_native_drivers()} == {"strands"}
    assert resolve_driver("so101", "lerobot") == "lerobot"


def test_a_name_may_have_any_spelling_and_must_be_text() -> None:
    for written, robot in {
        "franka": "panda",
        "FRANKA": "panda",
        "h1": "unitree_h1",
        "Go2": "unitree_go2",
        "SO100": "so100",
        "so100_follower": "so100",
        "reachy-mini": "reachy_mini",
        "robotiq": "robotiq_2f85",
        "nobody": "nobody",
    }.items():
        assert canonical_name(written) == robot
    for name in (None, 42, True, b"so100", ["so100"]):
        with pytest.raises(TypeError, match=r"Give the name of a robot as text: list_robots\(\)"):
            canonical_name(name)  # type: ignore[arg-type]
    for name in ("", "  ", "nope_bot"):
        for mode in ("sim", "real"):
            with pytest.raises(ValueError, match=r"list_robots\(\)"):
                Robot(name, mode, **({"port": "/dev/ttyACM0"} if mode == "real" else {}))


def test_robots_are_listed_by_mode() -> None:
    covered = list_driver_coverage()
    assert list_robots() == list_robots("all") == list(covered)
    assert set(list_robots("real")) == {name for name, drivers in covered.items() if drivers}
    assert set(list_robots("both")) == set(list_robots("sim")) & set(list_robots("real"))
    assert {"so100", "panda"} <= set(list_robots(mode="sim")) and "reachy2" not in list_robots("sim")
    assert "lekiwi" in list_robots("real") and "shadow_hand" not in list_robots("real")
    for robot in list_robots("sim"):
        assert "sim" in repr(Robot(robot))
    for mode in ("hardware", "sims", None):
        with pytest.raises(ValueError, match="Use 'all', 'sim', 'real', 'both'"):
            list_robots(mode)  # type: ignore[arg-type]
    groups = set(covered.values())
    assert groups == {("lerobot",), ("strands",), ("lerobot", "strands"), ()}
    for name, drivers in covered.items():
        assert ("strands" in drivers) is (get_native_driver_class(name) is not None)
        assert set(drivers) <= set(DRIVER_CHOICES) - {"auto"}
        assert not drivers or resolve_driver(name) in drivers


@pytest.mark.parametrize("name", ["left arm", "left_arm\n", "a/b", "", 3, "x" * 65])
def test_a_tool_name_must_be_valid_for_model_providers(name: Any) -> None:
    for keywords in ({}, ARM, {"port": "/dev/ttyACM0"}):  # the name is checked before the other keywords
        with pytest.raises(ValueError, match="Use 1 to 64 of A-Z a-z 0-9 _ -"):
            Robot("so101", tool_name=name, **keywords)


def test_a_robot_has_its_tool_name() -> None:
    for name in ("left-arm_2", "x" * 64):
        assert Robot("so101", tool_name=name).tool_name == Robot("so101", **ARM, tool_name=name).tool_name == name
    left = Robot("so101", **ARM, tool_name="left")
    assert (left.robot_name, left.tool_type, left.tool_spec["name"]) == ("left", "robot", "left")
    assert Robot("so101", **ARM, data_config="so100_dualcam").data_config == "so100_dualcam"


@pytest.mark.parametrize(
    ("robot", "keywords", "says"),
    [
        ("so101", {"port": "/dev/ttyACM0"}, r"port=. Add mode='real'"),
        ("so101", {"driver": "strands", "port": "/dev/ttyACM0"}, r"port=. Add mode='real'"),
        ("g1", {"network_interface": "eth0"}, r"network_interface=. Add mode='real'"),
        ("unitree_go2", {"network_interface": "eth0"}, r"network_interface=. Add mode='real'"),
        ("so101", {"robot_ip": "192.0.2.2"}, "takes no 'robot_ip'"),
        ("so101", {"mock": True}, "takes no 'mock'"),
        ("reachy_mini", {"ip_address": "reachy.local"}, "takes no 'ip_address'"),
        ("so101", {"position": []}, "Give 3 numbers"),
        ("so101", {"position": [NAN, 0.0, 0.0]}, "Give finite numbers"),
        ("so101", {"orientation": [1.0, 0.0, 0.0]}, "Give 4 numbers"),
        ("so101", {"orientation": [0.0, float("inf"), 0.0, 0.0]}, "Give finite numbers"),
        ("so101", {"keyframe": "nope"}, "so101 has only 'home'"),
        ("so101", {"backend": "nope"}, "Use one of 'mujoco', 'newton', 'isaac'"),
        ("so101", {**ARM, "position": [0.0, 0.0, 0.0]}, "only a simulation takes position="),
        ("so101", {**ARM, "keyframe": 0}, "only a simulation takes keyframe="),
        ("so101", {**ARM, "ports": ["/dev/a", "/dev/b"]}, "'ports' -> 'port'"),
        ("so101", {**ARM, "motor_ids": (1, 9)}, "shoulder_pan, shoulder_lift"),
        ("so101", {"mode": 3}, "'sim', 'real', 'auto'"),
        ("robotiq_2f85", {**GRIPPER, "tcp_port": "502"}, "tcp_port is '502'"),
        ("robotiq_2f85", {**GRIPPER, "unit_id": True}, "unit_id is True"),
        ("robotiq_2f85", {**GRIPPER, "force": float("inf")}, "force is inf"),
        ("ur5e", {**UR, "control_frequency": -5.0}, "control_frequency is -5.0"),
        ("ur5e", {**UR, "control_frequency": NAN}, "control_frequency is nan"),
        ("ur5e", {"mode": "real", "port": "192.0.2.30:502"}, "its ports are fixed"),
        ("unitree_go2", {**G1, "battery_floor_pct": NAN}, "battery_floor_pct"),
        ("ur5e", {"mode": "real"}, "needs 'port', its address"),
        ("unitree_g1", {"mode": "real"}, "needs 'port', its address"),
    ],
)
def test_an_unusable_keyword_is_refused_by_name(robot: str, keywords: dict[str, Any], says: str) -> None:
    with pytest.raises((ValueError, TypeError), match=says):
        Robot(robot, **keywords)


def test_any_name_is_simulated_by_a_file_and_keeps_its_keyframe(tmp_path: Path) -> None:
    """The keyframe is given by its name or its number. The first command holds it."""
    file = write_mjcf(tmp_path)
    folded = pytest.approx({"turn": 1.2, "reach": -0.05}, abs=0.02)
    for keyframe in ("folded", 0):
        assert "brand_new" in repr(Robot("brand_new", urdf_path=file, keyframe=keyframe))
    with Robot("brand_new", urdf_path=file, keyframe=0) as sim:
        sim.step(1000)
        assert sim.get_observation() == folded
    for name in (None, 42, ["so100"]):
        with pytest.raises(TypeError, match="Give the name of a robot as text"):
            Robot(name, urdf_path=file)  # type: ignore[arg-type]


def test_a_calibration_of_another_arm_is_refused() -> None:
    joints = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper", "spare")
    of_all = {
        joint: {"id": index, "drive_mode": 0, "homing_offset": 0, "range_min": 0, "range_max": 4095}
        for index, joint in enumerate(joints, 1)
    }
    with pytest.raises(ValueError, match="has unknown spare"):
        Robot("so101", **ARM, calibration=of_all)
    del of_all["spare"]
    Robot("so101", **ARM, calibration=of_all)
    with pytest.raises(ValueError, match="Give a path, a dict or None"):
        Robot("so101", **ARM, calibration=3)


@pytest.mark.parametrize("port", ["", "  ", "\n", None])
def test_a_blank_port_is_refused(port: str | None) -> None:
    for robot in ("so101", "koch", "ur5e", "unitree_g1", "robotiq_2f85", "spot"):
        with pytest.raises(ValueError, match=f"{robot} needs 'port'"):
            Robot(robot, mode="real", port=port)
    with pytest.raises(ValueError, match="radio://0/80/2M/E7E7E7E7E7"):
        Robot("crazyflie", mode="real", port=port)
    # this robot is found on the network
    assert Robot("booster_t1", mode="real", port=port).driver.robot == "booster_t1"


def test_a_port_must_be_text() -> None:
    for robot in ("so101", "ur5e", "unitree_g1", "koch"):
        for port in (5, False, b"/dev/ttyACM0", ["/dev/ttyACM0"]):
            with pytest.raises(TypeError, match="Give a path or an address, as text"):
                Robot(robot, mode="real", port=port)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="Give an address, without spaces"):
        Robot("ur5e", mode="real", port="192.0.2.30 30004")
    written = repr(Robot("so101", mode="real", port="/dev/serial/by-id/left arm"))
    assert written == repr(Robot("so101", mode="real", port=Path("/dev/serial/by-id/left arm")))  # type: ignore[arg-type]


def test_a_name_can_be_registered_once_in_any_spelling() -> None:
    for name in ("so101", "SO-101", "SO101", "so_101", "Franka", "so100_follower"):
        with pytest.raises(ValueError, match=f"{name} is known already. Pass overwrite=True"):
            register_robot(name)
    for name in ("a b", "a/b", "ärm", "x" * 65, "--", "arm\n"):
        with pytest.raises(ValueError, match="Use 1 to 64 characters of A-Z"):
            register_robot(name)
    with pytest.raises(ValueError, match="SO-101 is known already"):
        register_robot("bench_arm_7", aliases=["SO-101"])
    assert "bench_arm_7" not in list_robots()
    assert (canonical_name("SO-101"), list_native_drivers()["so101"]) == ("so101", "FeetechDriver")


def test_robots_with_legs_share_a_driver_class_and_keep_their_names() -> None:
    for name, robot in {"h1": "unitree_h1", "h1_2": "unitree_h1_2", "b2": "b2", "go2": "unitree_go2"}.items():
        legs = Robot(name, **G1)
        assert (legs.driver.robot, list_driver_coverage()[robot]) == (robot, ("strands",))
        assert get_native_driver_class(name) is get_native_driver_class("unitree_go2")


def test_a_class_without_the_members_of_a_driver_is_refused_with_their_names() -> None:
    with pytest.raises(TypeError, match="send_action"):
        register_native_driver("half_robot", Half)
    assert not isinstance(Half(), HardwareDriver)
    assert not [name for name in DRIVER_SURFACE if name.startswith("_")]


def test_without_a_connection_every_verb_answers_in_an_envelope() -> None:
    gripper = Robot("robotiq_2f85", **GRIPPER)
    assert isinstance(gripper, HardwareDriver)
    answers: list[Any] = [
        gripper.send_action({"gripper": 0.5, "aperture_mm": 3.0}),
        gripper.run_policy(lambda seen: {}),
        gripper.start_task("close it"),
        gripper.get_task_status(),
        gripper.stop_task(),
        dict(gripper.get_status()),
    ]
    assert [answer["status"] for answer in answers[:3]] == ["error"] * 3
    assert all(isinstance(answer["content"], list) for answer in answers)


def test_every_robot_that_strands_robots_knows_is_known_here() -> None:
    """At least by its name. The refusal of a robot without a driver says how it can be simulated."""
    assert {"aloha", "anymal_c", "openarm", "wx250s", "z1"} <= set(list_robots())
    with pytest.raises(
        ValueError, match=r"aloha has no native driver. To simulate it, register a model: register_robot"
    ):
        Robot("aloha")
    assert resolve_driver("openarm") == "strands"
