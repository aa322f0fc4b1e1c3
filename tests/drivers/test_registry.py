"""Test which driver a robot's name selects, and how another package or a script adds a driver."""

from __future__ import annotations

import importlib.metadata
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from strands_actors import Robot, drivers
from strands_actors.contract import contract_version
from strands_actors.contract.contract_version import unsupported_contract
from strands_actors.drivers import (
    DEFAULT_DRIVER,
    DRIVER_CHOICES,
    DRIVER_SURFACE,
    NATIVE_DRIVER,
    HardwareDriver,
    broken_drivers,
    canonical_name,
    constructor_keywords,
    drifted_driver_parameters,
    get_native_driver_class,
    list_driver_coverage,
    list_native_drivers,
    list_robots,
    missing_driver_members,
    port_kind,
    register_native_driver,
    register_robot,
    resolve_driver,
)
from strands_actors.drivers.feetech.driver import Feetech
from strands_actors.drivers.ur.driver import UR
from tests.conftest import REGISTRY


def test_the_robots_with_a_driver_are_listed_with_its_name() -> None:
    listed = list_native_drivers()
    assert listed["yahboom_m3pro"] == "YahboomM3ProDriver", "the class name on the drivers page"
    assert list(listed) == sorted(listed)
    assert {name: listed[name] for name in ("hope_jr", "open_duck_mini", "so100", "so101")} == dict.fromkeys(
        ("hope_jr", "open_duck_mini", "so100", "so101"), "FeetechDriver"
    )
    assert (listed["koch"], listed["ur5e"], listed["unitree_g1"]) == ("DynamixelDriver", "URDriver", "G1Driver")
    assert get_native_driver_class("so101_follower") is Feetech
    assert get_native_driver_class("toaster") is None


def test_coverage_lists_the_drivers_of_each_robot() -> None:
    coverage = list_driver_coverage()
    assert coverage["so101"] == ("lerobot", "strands")
    assert coverage["omx"] == ("lerobot",)
    assert coverage["ability_hand"] == ()
    assert coverage["open_duck_mini"] == ("strands",)
    assert list(coverage) == sorted(coverage)


def test_the_kind_of_a_port_is_known_by_name() -> None:
    assert (port_kind("so101"), port_kind("ur5e"), port_kind("toaster")) == ("serial", "address", None)
    assert (port_kind("omx"), port_kind("reachy2"), port_kind("ability_hand")) == ("serial", "address", None)
    assert (port_kind("SO-101"), port_kind("so100_follower")) == ("serial", "serial")
    assert {port_kind(name) for name in list_native_drivers()} == {"serial", "address"}


def test_constructor_keywords_are_those_of_the_driver_and_ours() -> None:
    ours = ["cameras", "data_config", "id", "mesh", "port", "require_drill", "sim", "tool_name", "transport"]
    gripper = ["gripper", "gripper_activate", "gripper_driven", "gripper_force", "gripper_speed"]
    assert constructor_keywords(UR) == sorted(
        [*ours, "control", "control_frequency", *gripper, "model", "rtde_frequency"]
    )
    servos = ["baud", "baud_rate", "calibration", "max_jump", "max_relative_target", "motor_ids", "timeout"]
    ends = ["lower_s", "on_exit", "rest"]
    assert constructor_keywords(Feetech) == sorted([*ours, *servos, *ends])

    class Seeing(Feetech):
        reads_cameras = True

    assert "cameras" in constructor_keywords(Seeing)

    class Open:
        def __init__(self, tool_name: str, *, port: str = "", **more: Any) -> None: ...

    assert constructor_keywords(Open) == ["**", "port", "tool_name"]


# -- resolving


def test_the_driver_is_the_requested_else_a_registered_else_a_native_one_else_lerobot() -> None:
    assert resolve_driver("so101") == "strands"
    assert resolve_driver("so101", "lerobot") == "lerobot"
    assert resolve_driver("omx") == "lerobot"
    register_robot("so101", hardware={"driver": "lerobot"}, overwrite=True)
    assert resolve_driver("so101") == "lerobot"
    assert resolve_driver("so101_follower") == "lerobot"
    assert resolve_driver("so101", "strands") == "strands"
    for robot, driver, text in (
        ("so101", "magic", "driver is 'magic'. Use one of 'auto', 'lerobot', 'strands'"),
        (
            "omx",
            "strands",
            "omx has no native driver. driver='lerobot' runs .* have a native driver: .*so100, so101",
        ),
    ):
        with pytest.raises(ValueError, match=text):
            resolve_driver(robot, driver)


def test_a_registered_robot_has_all_its_names(tmp_path: Path) -> None:
    class Own(Feetech):
        pass

    (model := tmp_path / "arm.xml").write_text("<mujoco/>")
    register_robot("my_arm", hardware={"driver": "strands"}, aliases=["mine"], model_xml=model)
    assert list_driver_coverage()["my_arm"] == ()
    with pytest.raises(ValueError, match="mine has no native driver"):
        Robot("mine", mode="real", port="/dev/ttyACM0")
    register_native_driver("my_arm", Own)
    assert canonical_name("mine") == "my_arm"
    assert list_driver_coverage()["my_arm"] == ("strands",)
    assert resolve_driver("mine") == "strands"
    register_robot("theirs", hardware={"driver": "lerobot"})
    assert list_driver_coverage()["theirs"] == ("lerobot",)
    with pytest.raises(ValueError, match="LeRobot has no class for theirs"):
        Robot("theirs")


@pytest.mark.parametrize(
    ("name", "keywords", "text"),
    [
        ("so101", {}, "so101 is known already. Pass overwrite=True"),
        ("new", {"aliases": ["so_arm101"]}, "so_arm101 is known already"),
        ("ability_hand", {}, "ability_hand is known already"),
        ("new", {"hardware": {"driver": "magic"}}, "hardware driver is 'magic'. Use 'strands' or 'lerobot'"),
        ("new", {"hardware": {"wheels": "4"}}, "hardware has the unknown key wheels. Give only 'driver'"),
    ],
)
def test_a_robot_that_cannot_be_registered_is_not(name: str, keywords: dict[str, Any], text: str) -> None:
    before = list_driver_coverage()
    with pytest.raises(ValueError, match=text):
        register_robot(name, **keywords)
    assert list_driver_coverage() == before


# -- driver classes


class Half:
    """A driver class with only two of the required members."""

    tool_name = "half"

    def stop(self) -> None: ...


class Whole(Half):
    """A driver class with all required members except ``start_task``."""

    tool_type, tool_spec = "robot", None

    def nothing(self) -> None: ...

    cleanup = get_status = get_task_status = run_policy = send_action = stop_task = stream = nothing


def test_a_class_that_lacks_members_is_refused_by_their_names() -> None:
    missing = missing_driver_members(Half)
    assert missing == sorted(missing)
    assert {"cleanup", "send_action", "run_policy", "tool_spec", "stream"} <= set(missing)
    assert not {"stop", "tool_name"} & set(missing)
    with pytest.raises(TypeError) as refusal:
        register_native_driver("half", Half)
    assert str(refusal.value) == f"register_native_driver: the class Half lacks {', '.join(missing)}. Add them"
    assert "half" not in list_native_drivers()


def test_a_name_is_bound_once_unless_it_is_to_be_replaced() -> None:
    assert missing_driver_members(Feetech) == []

    class Other(Feetech):
        pass

    with pytest.raises(ValueError, match="so101 already has the driver FeetechDriver"):
        register_native_driver("so101", Other)
    register_native_driver("so101", Other, overwrite=True)
    assert list_native_drivers()["so101"] == "Other"
    with pytest.raises(ValueError, match=r"there is no robot 'so102'. Call register_robot\('so102'\) first"):
        register_native_driver("so102", Other)
    register_robot("so102", aliases=["so102_follower"])
    register_native_driver("SO-102-follower", Other)
    assert list_driver_coverage()["so102"] == ("strands",)
    assert "so102" in list_robots()


def test_a_class_may_name_its_robots_itself() -> None:
    class Named(Feetech):
        SUPPORTED_ROBOTS = ("named_arm",)

    register_native_driver("named_arm", Named)
    assert get_native_driver_class("named_arm") is Named


def test_the_words_of_the_page_are_there() -> None:
    assert (NATIVE_DRIVER, DEFAULT_DRIVER) == ("strands", "lerobot")
    assert DRIVER_CHOICES == ("auto", "lerobot", "strands", "ros2")
    assert "start_task" not in DRIVER_SURFACE
    assert {"send_action", "stop", "tool_name"} < set(DRIVER_SURFACE)
    assert isinstance(Whole(), HardwareDriver)
    assert not isinstance(Half(), HardwareDriver)
    assert missing_driver_members(Whole) == []


def test_a_class_for_another_version_of_the_contract_is_not_registered() -> None:
    class Later(Feetech):
        SUPPORTED_ROBOTS = ("later_arm",)
        CONTRACT_VERSION = 2

    class PlainLater(Half):  # It lacks members, too. Its version explains why.
        CONTRACT_VERSION = 2

    for name, cls in (("later_arm", Later), ("half", PlainLater)):
        with pytest.raises(ValueError, match="written for version 2 of the driver contract") as refusal:
            register_native_driver(name, cls)
        assert str(refusal.value) == f"register_native_driver: {unsupported_contract(cls)}"
        assert name not in list_native_drivers()


class Drifted:
    def run_policy(self, policy_object: Any, instruction: str = "", duration: float = 1.0) -> None: ...
    def send_action(self, joints: dict[str, float]) -> None: ...
    def start_task(self, instruction: str, **more: Any) -> None: ...
    def stop(self, now: bool = True) -> None: ...


def test_parameters_that_are_not_those_of_the_page_are_named() -> None:
    assert drifted_driver_parameters(Drifted) == {
        "run_policy": ["n_steps"],  # a policy is also accepted as policy_object
        "send_action": ["action", "robot_name"],
    }
    assert drifted_driver_parameters(Feetech) == {}


# -- other packages


class Theirs(Feetech):
    SUPPORTED_ROBOTS = ("their_arm", "so101")
    ALIASES = {"their_arm_v2": "their_arm"}  # noqa: RUF012


class Later(Theirs):
    """A driver for a contract that this package does not have yet."""

    SUPPORTED_ROBOTS = ("later_arm",)
    CONTRACT_VERSION = 2


class Declared(Theirs):
    SUPPORTED_ROBOTS = ("declared_arm",)
    CONTRACT_VERSION = 1


@pytest.fixture
def packages(registry: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install third-party packages: good drivers, one that raises, one that is no driver, and one that was written
    for a later version of the contract."""
    module = ModuleType("their_drivers")
    module.__dict__.update(Theirs=Theirs, Half=Half, Later=Later, Declared=Declared)
    monkeypatch.setitem(sys.modules, "their_drivers", module)
    group = "strands_actors.drivers"
    points = [
        EntryPoint("good", "their_drivers:Theirs", group),
        EntryPoint("gone", "no_such_module:Driver", group),
        EntryPoint("half", "their_drivers:Half", group),
        EntryPoint("later", "their_drivers:Later", group),
        EntryPoint("declared", "their_drivers:Declared", group),
        EntryPoint("feetech", "their_drivers:Half", group),  # a package cannot replace a built-in wire
    ]
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: points)
    for name in REGISTRY:
        getattr(drivers, name).clear()
    monkeypatch.setattr(drivers, "_loaded", False)


@pytest.mark.usefixtures("packages")
def test_another_packages_driver_is_found_and_a_broken_one_only_warns() -> None:
    with pytest.warns(UserWarning) as reported:
        listed = list_native_drivers()
    assert listed["their_arm"] == "Theirs"
    assert listed["so101"] == "FeetechDriver"
    assert canonical_name("their_arm_v2") == "their_arm"
    broken = broken_drivers()
    assert sorted(broken) == ["gone", "half", "later"]
    assert broken["gone"] == "ModuleNotFoundError: No module named 'no_such_module'"
    assert broken["half"].startswith("TypeError: Half lacks cleanup, get_status")
    assert broken["later"] == f"ValueError: {unsupported_contract(Later)}"
    assert "later_arm" not in listed and listed["declared_arm"] == "Declared"
    assert [str(warning.message) for warning in reported] == [
        f"driver {name} cannot be used: {why}" for name, why in sorted(broken.items())
    ]
    assert list_native_drivers() == listed  # the warning appears once


@pytest.mark.usefixtures("packages")
def test_our_own_drivers_need_not_declare_the_version_of_their_contract(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contract_version, "CONTRACT_VERSION", 2)
    monkeypatch.setattr(contract_version, "OLDEST_CONTRACT_VERSION", 2)
    with pytest.warns(UserWarning):
        listed = list_native_drivers()
    assert listed["later_arm"] == "Later" and listed["so101"] == "FeetechDriver"
    assert sorted(broken_drivers()) == ["declared", "gone", "good", "half"]


THEIRS = """
crazyflie: cf2 bitcraze_crazyflie
fr3: franka_fr3
fr3_v2: franka_fr3_v2
koch: koch_follower koch_v1.1 low_cost_robot_arm
kuka_iiwa: kuka_iiwa_14
panda: bimanual_panda_gripper bimanual_panda_hand franka franka_emika_panda franka_panda libero_panda
panda: oxe_droid oxe_droid_rel oxe_droid_relative_eef_relative_joint single_panda_gripper
so100: so100_4cam so100_dualcam so100_follower so_arm100 trs_so_arm100
so101: robotstudio_so101 so101_dualcam so101_follower so101_tricam
xarm7: ufactory_xarm7
reachy_mini: pollen_reachy_mini reachy reachy-mini reachymini
robotiq_2f85: robotiq
microduck: micro_duck pollen_microduck
open_duck_mini: bdx mini_bdx open_duck open_duck_mini_v2 open_duck_v2
rby1: rby1a rainbow_rby1
unitree_g1: g1 g1_wbc real_g1_relative_eef_relative_joints unitree_g1_full_body unitree_g1_locomanip
unitree_g1: unitree_g1_real unitree_g1_sonic unitree_g1_wbc
unitree_h1: h1
unitree_h1_2: h1_2
earthrover: earth_rover earthrover_mini_plus frodobots
yahboom_m3pro: m3pro m3_pro rosmaster_m3_pro rosmaster_m3pro yahboom_m3_pro yahboom_rosmaster_m3_pro
spot: boston_dynamics_spot
stretch: hello_robot_stretch_original
stretch3: hello_robot_stretch hello_robot_stretch_3
unitree_go2: go2
"""


def test_every_alias_of_the_references_registry_is_known() -> None:
    wrong = {}
    for line in THEIRS.strip().splitlines():
        robot, _, names = line.partition(": ")
        wrong |= {name: canonical_name(name) for name in names.split() if canonical_name(name) != robot}
    assert wrong == {}
