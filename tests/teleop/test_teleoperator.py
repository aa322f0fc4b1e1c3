"""``Teleoperator(...)`` before any process starts: its attributes and its refusals."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors import Robot, Teleoperator
from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers import list_leaders, list_robots
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.surfaces.cli.teleop import leader_of
from strands_actors.teleoperation import lerobot
from strands_actors.teleoperation.machine import Kind
from tests.answers import json_of, task, until, why

REFUSALS: list[tuple[str, dict[str, Any], str]] = [
    ("so102_leader", {"port": "x"}, "is not known. Did you mean: so101_leader"),
    ("so101_leader", {}, "give so101_leader one of port= and transport='twin'"),
    ("so101_leader", {"port": "x", "transport": "twin"}, "one of port= and transport='twin'"),
    ("so101_leader", {"transport": "smoke"}, "It offers twin"),
    ("so101_leader", {"port": "x", "wheels": 4}, "takes no wheels. It takes calibration, baud"),
    ("so101_leader", {"port": "x", "baud": 9600}, "baud is 9600"),
    ("so101_leader", {"port": ""}, "port is ''. Give it as text: '/dev/ttyACM1'"),
    ("so101_leader", {"port": 5}, "port is 5. Give it as text"),
    ("so101_leader", {"transport": "twin", "id": 5}, "id is 5. Give it as text: 'left'"),
    ("so101_leader", {"transport": "twin", "relative": "no"}, "relative is 'no'. Give True or False"),
    ("tests.x:Y", {"relative": 1}, "relative is 1. Give True or False"),
    ("keyboard", {"port": "x"}, "keyboard has no port"),
    ("keyboard", {"relative": True}, "keyboard takes no relative"),
    ("tests.x:Y", {"transport": "twin"}, "has no transport"),
]


@pytest.mark.parametrize(("name", "keywords", "expected"), REFUSALS)
def test_invalid_keywords_are_refused_with_the_valid_ones(
    name: str, keywords: dict[str, Any], expected: str
) -> None:
    with pytest.raises((ValueError, TypeError)) as refused:
        Teleoperator(name, **keywords)
    assert expected in str(refused.value)


def test_leaders_are_no_robots_and_have_their_followers_joints() -> None:
    assert sorted(list_leaders()) == ["koch_leader", "so100_leader", "so101_leader"]
    assert not set(list_leaders()) & set(list_robots())
    for name in ("so101_leader", "SO-101 leader", "so_arm101_leader"):
        leader = Teleoperator(name, port="/dev/null")
        assert leader.name == "so101_leader" and leader.is_arm and leader.kind is Kind.ABSOLUTE
        assert leader.driver.axes == (
            "shoulder_pan",
            "shoulder_lift",
            "elbow_flex",
            "wrist_flex",
            "wrist_roll",
            "gripper",
        )


@pytest.mark.parametrize("name", ["so100_leader", "so101_leader", "koch_leader"])
def test_the_wire_of_a_leader_neither_arms_nor_writes(name: str) -> None:
    driver = Teleoperator(name, port="/dev/null").driver
    wire = driver.open_wire(MonotonicClock())
    assert wire.config.passive  # type: ignore[attr-defined]

    class Permit:
        def check(self) -> None:
            raise PermitDenied

    with pytest.raises(WireDown, match="never energised"):
        trio.run(wire.arm, Permit())
    with pytest.raises(WireDown, match="never energised"):
        trio.run(wire.write, (0.0,) * 6, Permit())


def test_the_calibration_of_a_leader_is_lerobots_file_of_a_teleoperator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    file = tmp_path / "teleoperators" / "so_leader" / "left.json"
    file.parent.mkdir(parents=True)
    names = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
    motors = {
        name: {"id": at, "drive_mode": 0, "homing_offset": 0, "range_min": 1000, "range_max": 3000}
        for at, name in enumerate(names, 1)
    }
    file.write_text(json.dumps(motors))
    calibrated = Teleoperator("so101_leader", port="/dev/null", id="left").driver
    assert calibrated.travel()["shoulder_pan"] == pytest.approx((-87.9, 87.9), abs=0.1)
    other = Teleoperator("so101_leader", port="/dev/null")
    assert other.driver.travel() == {}
    (caveat,) = other.caveats
    assert "so101_leader is not calibrated" in caveat and "Give one of the ids that are calibrated (left)" in caveat
    assert caveat.endswith("or run `strands-actors calibrate so101_leader --port /dev/null`")
    named = Teleoperator("so101_leader", port="/dev/null", id="my right")
    assert named.caveats[0].endswith("calibrate so101_leader --port /dev/null --id 'my right'`"), (
        "the command writes the file of this id"
    )
    for by_command in (leader_of("so101_leader:/dev/null:left"), leader_of("so101_leader:/dev/null", "left")):
        assert by_command.driver.travel() == calibrated.travel() and by_command.caveats == ()
    assert Teleoperator("so101_leader", transport="twin").caveats == ()


def test_a_hand_moves_twins_alone() -> None:
    with pytest.raises(TypeError, match="is not simulated"):
        Teleoperator("so101_leader", port="/dev/null").move_by_hand({"gripper": 1.0})
    with pytest.raises(TypeError, match="is not a leader arm"):
        Teleoperator("keyboard").move_by_hand({"gripper": 1.0})
    with pytest.raises(TypeError, match="has no elbow"):
        Teleoperator("so101_leader", transport="twin").move_by_hand({"elbow": 1.0})


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        (5, "positions is 5. Give joints: {'shoulder_pan': 10.0}"),
        (None, "positions is None. Give joints"),
        (["shoulder_pan"], "positions is ['shoulder_pan']. Give joints"),
        ({5: 1.0}, "has no 5. It has shoulder_pan"),
        ({"shoulder_pan": "x"}, "shoulder_pan is 'x'. Give a finite number, in degrees"),
        ({"shoulder_pan": None}, "shoulder_pan is None. Give a finite number"),
        ({"shoulder_pan": float("nan")}, "shoulder_pan is nan. Give a finite number"),
        ({"shoulder_pan": float("inf")}, "shoulder_pan is inf. Give a finite number"),
    ],
)
def test_saf_014_invalid_positions_of_move_by_hand_are_refused(positions: Any, message: str) -> None:
    with pytest.raises(TypeError) as refused:
        Teleoperator("so101_leader", transport="twin").move_by_hand(positions)
    assert message in str(refused.value)


def test_a_koch_leader_is_moved_by_hand_and_read_and_leads_its_follower() -> None:
    with Teleoperator("koch_leader", transport="twin") as leader:
        leader.move_by_hand({"shoulder_pan": 5.0, "elbow_flex": 0.0, "shoulder_lift": 0.0})
        arm = Robot("koch", mode="real", transport="twin")
        try:
            assert until(lambda: arm.connect_eagerly() is None, "it connects")
            assert "deadman is" in why(arm.attach_teleop(leader, deadman="nose"))
            json_of(arm.attach_teleop(leader))
            values = until(lambda: task(arm).get("teleop", {}).get("values"), "it is read")
            assert values["shoulder_pan"] == pytest.approx(5.0, abs=1.0)
        finally:
            arm.cleanup()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("so101_leader:/dev/ttyACM1", "<Teleoperator so101_leader (/dev/ttyACM1)>"),
        ("so101_leader:twin", "<Teleoperator so101_leader (twin)>"),
        ("keyboard", "<Teleoperator keyboard (None)>"),
    ],
)
def test_the_command_parses_the_connection_of_a_leader(text: str, expected: str) -> None:
    assert repr(leader_of(text)) == expected


def test_a_port_name_with_colons_is_not_an_id(tmp_path: Path) -> None:
    port = tmp_path / "pci-0000:00:14.0-usb-0:1:1.0"
    port.symlink_to("/dev/null")
    assert repr(leader_of(f"so101_leader:{port}")) == f"<Teleoperator so101_leader ({port})>"
    assert repr(leader_of(f"so101_leader:{port}:left")) == f"<Teleoperator so101_leader ({port})>"


def test_the_command_takes_one_id_and_only_for_an_arm() -> None:
    with pytest.raises(ValueError, match="have different ids"):
        leader_of("so101_leader:/dev/null:left", "right")
    for text in ("keyboard", "phone", "phone:127.0.0.1"):
        with pytest.raises(TypeError, match="has no id"):
            leader_of(text, "right")


def test_a_twin_with_an_id_is_not_a_port() -> None:
    assert vars(leader_of("so101_leader:twin:left"))["_port"] is None
    with pytest.raises(ValueError, match="have different ids"):
        leader_of("so101_leader:twin:left", "right")


def test_a_leaders_id_names_a_file_in_its_folder() -> None:
    for text in ("../left", "a/b", "x" * 200, "a\nb"):
        with pytest.raises(ValueError, match=r"cannot name a calibration file\. Give 1 to 100 characters"):
            leader_of("so101_leader:/dev/null", text)
    assert repr(leader_of("so101_leader:/dev/null", "my left arm.v2")) == "<Teleoperator so101_leader (/dev/null)>"


def test_the_command_requires_the_port_of_a_leader() -> None:
    with pytest.raises(ValueError, match="lacks the port of the leader"):
        leader_of("so101_leader")


@pytest.fixture
def forgets_lerobot() -> Iterator[None]:
    """Remove the stand-in's modules afterwards, because another test has another stand-in."""
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] in ("lerobot", "draccus")]:
        del sys.modules[name]


@pytest.mark.usefixtures("forgets_lerobot")
def test_lerobots_own_are_made_by_their_type(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The stand-in has the registry, the discovery and the factory of lerobot's package."""
    if "lerobot" not in sys.modules and not lerobot.is_installed():
        with pytest.raises(ValueError, match="needs lerobot, which is not installed"):
            Teleoperator("lerobot:stick")
    stand_in(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in [name for name in sys.modules if name == "lerobot" or name.startswith("lerobot.")]:
        monkeypatch.delitem(sys.modules, name)
    importlib.invalidate_caches()
    made = lerobot.make("stick", gain=2.0)
    assert made.get_action() == {"shoulder_pan.pos": 2.0}
    with pytest.raises(ValueError, match="no teleoperator 'wheel'"):
        lerobot.make("wheel")
    with pytest.raises(ValueError, match=r"stick has no option speed\. Use gain"):
        lerobot.make("stick", speed=2.0)
    made.connect()
    with pytest.raises(ConnectionError, match=r"stick 'left' is not calibrated .* --teleop\.id=left"):
        lerobot.make("stick", gain=0.0, id="left").connect()  # a prompt would block here
    leader = Teleoperator("lerobot:stick", gain=2.0, id="right", port="/dev/ttyACM9")
    source = trio.run(leader.source)
    assert source["factory"] == lerobot.FACTORY
    assert source["options"] == {"type": "stick", "gain": 2.0, "id": "right", "port": "/dev/ttyACM9"}


def stand_in(root: Path) -> None:
    """Write the parts of lerobot that the adapter uses, under their module names."""
    package = root / "lerobot" / "teleoperators"
    for folder in (package / "stick", package / "wants_more", root / "lerobot" / "utils"):
        folder.mkdir(parents=True)
    for folder in (root / "lerobot", package, root / "lerobot" / "utils"):
        (folder / "__init__.py").touch()
    (root / "draccus.py").write_text("def decode(config_class, given):\n    return config_class(**given)\n")
    (root / "lerobot" / "utils" / "import_utils.py").write_text("def register_third_party_plugins(): pass\n")
    (package / "config.py").write_text(
        "class TeleoperatorConfig:\n"
        "    known = {}\n"
        "    @classmethod\n"
        "    def get_known_choices(cls):\n"
        "        return dict(cls.known)\n"
    )
    (package / "wants_more" / "__init__.py").write_text("import a_package_that_is_not_there\n")
    (package / "stick" / "__init__.py").write_text(
        "from ..config import TeleoperatorConfig\n"
        "class Config:\n"
        "    def __init__(self, gain, id=None):\n"
        "        self.gain = gain\n"
        "TeleoperatorConfig.known['stick'] = Config\n"
    )
    (package / "utils.py").write_text(
        "class Stick:\n"
        "    def __init__(self, config):\n"
        "        self.config = config\n"
        "    @property\n"
        "    def is_calibrated(self):\n"
        "        return self.config.gain != 0.0\n"
        "    def connect(self, calibrate=True):\n"
        "        assert not calibrate\n"
        "    def disconnect(self): ...\n"
        "    def get_action(self):\n"
        "        return {'shoulder_pan.pos': self.config.gain}\n"
        "def make_teleoperator_from_config(config):\n"
        "    return Stick(config)\n"
    )
