"""Put an earlier calibration back, and take one from a file: old forms, files of other robots, damaged files."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors.drivers.common.kit.calibration import MotorCalibration
from strands_actors.drivers.common.servo.calibrating import Proposal
from strands_actors.drivers.common.servo.findings import Finding, Kind
from strands_actors.drivers.common.servo.recalibrating import read_file
from strands_actors.testing import Twin

from .hands import JOINTS, Hands, class_of, plan_of, registers_of, setup_of

commands = importlib.import_module("strands_actors.surfaces.cli.calibrate")
person = importlib.import_module("strands_actors.surfaces.cli.person")
READ = Path(__file__).with_name("as_lerobot_writes_it.json")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path / "lerobot"))
    return tmp_path / "lerobot" / "robots" / "so_follower"


def at_terminal(monkeypatch: pytest.MonkeyPatch, hands: Hands) -> None:
    """Let hands act in place of the person at the terminal, and the stops be where they move to."""
    monkeypatch.setattr(commands, "Terminal", lambda quiet: hands)
    monkeypatch.setattr(commands, "_plan", lambda driver_class, name, accept: plan_of(name))


def test_the_values_before_a_calibration_are_kept_and_put_back(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with Twin("so101", tmp_path, by_hand=True) as twin:
        before = registers_of("so101", twin)
        at_terminal(monkeypatch, Hands(twin))
        assert commands.calibrate("so101", twin.port, "left", as_json=True) == 0
        answer = json.loads(capsys.readouterr().out)
        assert list(answer["ranges"]) == list(JOINTS) and answer["findings"] == []
        after, file = registers_of("so101", twin), (home / "left.json").read_text()
        assert after != before
        for registers, text in ((before, None), (after, file), (before, None)):
            commands.calibrate("so101", twin.port, "left", as_json=False, undo=True)
            assert registers_of("so101", twin) == registers
            assert ((home / "left.json").read_text() if (home / "left.json").exists() else None) == text
    assert "--undo once more" in capsys.readouterr().out


def test_a_file_is_compared_with_the_servos_and_written_into_them(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with Twin("so101", tmp_path, by_hand=True) as twin:
        hands = Hands(twin)
        monkeypatch.setattr(commands, "Terminal", lambda quiet: hands)
        commands.calibrate("so101", twin.port, "left", as_json=True, source=READ)
        found = json.loads(capsys.readouterr().out)["findings"]
        differs = {"kind": "differs", "joint": "shoulder_pan", "register": "homing_offset", "file_value": 412}
        assert differs in found and not hands.asked
        assert json.loads((home / "left.json").read_text()) == json.loads(READ.read_text())
        written = registers_of("so101", twin)["shoulder_pan"]
        assert (written["homing_offset"], written["range_min"], written["range_max"]) == (412, 905, 3160)
        commands.calibrate("so101", twin.port, "left", as_json=True, source=home / "left.json")
        assert json.loads(capsys.readouterr().out)["findings"] == [], "now the servos agree"


Change = Callable[[dict[str, Any]], Any]


def changed(joint: str, **fields: Any) -> Change:
    return lambda content: {**content, joint: {**content[joint], **fields}}


OLD = {"motor_names": list(JOINTS), "homing_offset": [0] * 6, "start_pos": [0] * 6, "end_pos": [0] * 6}


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda content: OLD, r"has the form of LeRobot 0.2 or older .* Calibrate again"),
        (lambda content: [], "must be an object with one entry per motor"),
        (lambda content: {"elbow": content.pop("elbow_flex"), **content}, "lacks elbow_flex and has unknown elbow"),
        (changed("elbow_flex", id=7), "the file has id 7 for elbow_flex, this robot has id 3"),
        (changed("elbow_flex", range_max=880), "elbow_flex: range_min 880 must be below range_max 880"),
        (changed("elbow_flex", range_min=0, range_max=4095), "is a whole turn. The joint passed the end"),
        (changed("elbow_flex", range_max=1500), r"620 counts, and the joint has about 2203. .* another robot"),
        (changed("elbow_flex", homing_offset=90_000), "homing_offset is 90000, must be -2047..2047"),
        (changed("elbow_flex", homing_offset="1"), "elbow_flex: homing_offset is '1', must be an integer"),
        (changed("elbow_flex", range_max=9000), "range_max is 9000, must be 0..4095"),
    ],
)
def test_a_file_that_is_not_of_this_robot_is_refused_by_field(change: Change, text: str, tmp_path: Path) -> None:
    file = tmp_path / "file.json"
    file.write_text(json.dumps(change(json.loads(READ.read_text()))))
    with pytest.raises(ValueError, match=text):
        read_file(setup_of("so101", "/dev/null"), plan(), file)


def plan() -> Any:
    return commands._plan(class_of("so101"), "so101", ())


def test_a_cut_file_and_a_missing_one_are_refused(tmp_path: Path) -> None:
    (tmp_path / "cut.json").write_text(READ.read_text()[:300])
    for name, text in (("cut.json", "cannot be read"), ("gone.json", "it does not exist")):
        with pytest.raises(ValueError, match=text):
            read_file(setup_of("so101", "/dev/null"), plan(), tmp_path / name)


def test_a_range_that_passed_the_end_of_the_encoder_is_mended(tmp_path: Path) -> None:
    """The servo counts the same positions of the joint, now within one turn."""
    original = json.loads(READ.read_text())
    file = tmp_path / "file.json"
    file.write_text(json.dumps(changed("elbow_flex", range_min=2400, range_max=4600)(original)))
    motors, mended = read_file(setup_of("so101", "/dev/null"), plan(), file)
    assert mended == ["elbow_flex"]
    motor, old = motors["elbow_flex"], original["elbow_flex"]
    assert (motor.range_min + motor.homing_offset - 2400 - old["homing_offset"]) % 4096 == 0
    assert (motor.range_max + motor.homing_offset - 4600 - old["homing_offset"]) % 4096 == 0
    with pytest.raises(ValueError, match="range_max is 4600"):
        read_file(setup_of("koch", "/dev/null"), plan(), file)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (None, "does not exist: no earlier values were kept"),
        ("{", "cannot be read"),
        ('{"robot": "koch"}', "robot is 'koch', must be so101"),
        ('{"robot": "so101", "registers": {}}', "registers must have exactly shoulder_pan"),
    ],
)
def test_values_that_cannot_be_put_back_are_refused(home: Path, content: str | None, text: str) -> None:
    home.mkdir(parents=True)
    if content is not None:
        (home / "left.before").write_text(content)
    with pytest.raises(commands.Problem, match=text):
        commands.calibrate("so101", "/dev/null", "left", as_json=True, undo=True)


@pytest.mark.parametrize(("line", "confirmed"), [("yes\n", True), ("\n", False), ("y\n", False)])
def test_the_result_is_shown_and_only_yes_confirms_it(
    line: str, confirmed: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def typed(self: object) -> str:
        return line

    monkeypatch.setattr(person.Terminal, "_line", typed)
    motor = MotorCalibration(1, 0, 412, 905, 3160)
    finding = Finding(Kind.WRAPS, "shoulder_pan")
    before = {"shoulder_pan": {"homing_offset": -3}}
    proposal = Proposal({"shoulder_pan": motor}, {"shoulder_pan": 2255}, (finding,), before, {})
    assert trio.run(person.Terminal(quiet=False).confirm, proposal) is confirmed
    shown = capsys.readouterr().err
    assert "198.2 deg" in shown and "-3 -> 412" in shown and "905-3160" in shown
    assert "starts at 0 again within its range" in shown and "Nothing was written yet" in shown


def test_options_that_exclude_each_other_and_unknown_joints_are_refused(home: Path) -> None:
    with pytest.raises(commands.Problem, match="--undo and --from were both given"):
        commands.calibrate("so101", "/dev/null", "left", True, source=READ, undo=True)
    with pytest.raises(commands.Problem, match=r"--accept is 'elbow'\. Use firmware, shoulder_pan"):
        commands.calibrate("so101", "/dev/null", "left", True, accept=("elbow",))
