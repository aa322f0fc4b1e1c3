"""Keywords of strands-robots' verbs that scripts use with its simulations. They have the same meaning here."""

from __future__ import annotations

import json
import struct
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strands_actors import Robot, SimRobot
from strands_actors.caller.handle import sim_recording
from tests.answers import json_of, why

from .helpers import Ahead


@pytest.fixture(scope="module")
def sim() -> Iterator[SimRobot]:
    with Robot("so101") as simulated:
        yield simulated


def pixels(png: bytes) -> np.ndarray[Any, Any]:
    """Read a PNG of 8 bits RGB without filters, and check its checksums."""
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    offset, size, packed = 8, (0, 0), b""
    while offset < len(png):
        (length,) = struct.unpack_from(">I", png, offset)
        kind, data = png[offset + 4 : offset + 8], png[offset + 8 : offset + 8 + length]
        assert zlib.crc32(kind + data) == struct.unpack_from(">I", png, offset + 8 + length)[0]
        if kind == b"IHDR":
            size = struct.unpack_from(">II", data)
        packed += data if kind == b"IDAT" else b""
        offset += 12 + length
    rows = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(size[1], 1 + 3 * size[0])
    assert not rows[:, 0].any()
    return rows[:, 1:].reshape(size[1], size[0], 3)


# -- render


def test_a_picture_by_camera_name_is_a_png_in_an_answer(sim: SimRobot) -> None:
    array = sim.render(64, 48, "front")
    answer = sim.render(camera_name="front", width=64, height=48)
    assert answer["status"] == "success"
    image, facts = answer["content"][0]["image"], answer["content"][1]["json"]
    assert image["format"] == "png" and facts == {"camera": "front", "width": 64, "height": 48}
    drawn = pixels(image["source"]["bytes"])
    assert drawn.shape == array.shape == (48, 64, 3)
    assert np.abs(drawn.astype(int) - array.astype(int)).mean() < 3
    by_place: Any = sim.render("default", 64, 48)  # type: ignore[call-overload]
    assert pixels(by_place["content"][0]["image"]["source"]["bytes"]).shape == (48, 64, 3)


def test_a_failure_by_camera_name_is_an_error_envelope(sim: SimRobot) -> None:
    assert "attic" in why(sim.render(camera_name="attic"))
    assert why(sim.render(camera_name="front", width=-1)).startswith("render: ")


# -- run_policy


def test_run_policy_with_keywords_of_strands_robots_waits(sim: SimRobot) -> None:
    for words in ({"robot_name": "so101"}, {}):
        policy = Ahead()
        ended = json_of(sim.run_policy(policy_object=policy, n_steps=5, **words))
        assert (ended["running"], ended["steps"], ended["exit_reason"]) == (False, 5, "n_steps")
        assert policy.steps == 5
    assert json_of(sim.run_policy("so101", policy_provider="mock", n_steps=3))["steps"] == 3
    assert json_of(sim.run_policy(robot_name="so101", n_steps=3))["steps"] == 3, (
        "the mock policy is the default, as in strands-robots"
    )


def test_run_policy_with_keywords_of_this_package_returns_at_once(sim: SimRobot) -> None:
    assert json_of(sim.run_policy(Ahead(), n_steps=50))["running"]
    sim.stop_task()
    assert json_of(sim.run_policy(policy_object=Ahead(), n_steps=50, wait=False))["running"]
    sim.stop_task()


def test_invalid_values_of_these_keywords_are_refused(sim: SimRobot) -> None:
    assert "robot_name is 'ur5e'" in why(sim.run_policy(robot_name="ur5e", policy_object=Ahead()))
    assert "both given" in why(sim.run_policy(Ahead(), policy_provider="mock"))
    assert why(sim.run_policy(policy_provider="mok")).startswith("run_policy: ")


# -- start_recording


def test_a_simulation_is_recorded_into_a_dataset(tmp_path: Path) -> None:
    root = tmp_path / "pick"
    with Robot("so101", tool_name="recorded") as sim:
        assert not json_of(sim.get_recording_status())["recording"]
        assert json_of(sim.stop_recording())["reason"] == "nothing was recorded"
        began = json_of(sim.start_recording(repo_id="me/pick", task="pick", fps=20, root=root))
        assert (began["root"], began["task"]) == (str(root), "pick")
        assert "Call stop_recording()" in why(sim.start_recording(root=tmp_path / "other"))
        json_of(sim.run_policy(robot_name="recorded", policy_provider="mock", duration=1.0))
        assert json_of(sim.get_recording_status())["recording"]
        ended = json_of(sim.stop_recording())
        assert ended["episode"] == 0 and ended["frames"] >= 5
        json_of(sim.start_recording(root=root, fps=20))  # the dataset gets another episode
        time.sleep(0.5)
    info = json.loads((root / "meta" / "info.json").read_text())
    assert info["total_episodes"] == 2, "cleanup() saves the running episode"
    assert info["total_frames"] > ended["frames"]


def test_a_recording_that_is_not_possible_is_an_error_envelope(sim: SimRobot, tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    assert "is not removed" in why(sim.start_recording(root=tmp_path, overwrite=True))
    assert (tmp_path / "thesis.txt").exists()
    assert "nothing is uploaded" in why(sim.start_recording(root=tmp_path, push_to_hub=True))
    assert "fps is 0" in why(sim.start_recording(root=tmp_path / "a", fps=0))
    assert "no codec" in why(sim.start_recording(root=tmp_path / "a", vcodec="vp9"))
    assert not (tmp_path / "a").exists()
    assert not json_of(sim.get_recording_status())["recording"]


def test_a_dataset_is_in_lerobots_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path))
    assert sim_recording.folder_of("me/pick") == tmp_path / "me/pick"
    assert sim_recording.folder_of("/data/pick") == Path("/data/pick")
    for wrong in ("me/../../etc", "", "a\0b", 3):
        with pytest.raises(ValueError, match="repo_id is"):
            sim_recording.folder_of(wrong)


def test_remove_dataset_removes_a_dataset(tmp_path: Path) -> None:
    dataset = tmp_path / "pick"
    (dataset / "meta").mkdir(parents=True)
    (dataset / "meta" / "info.json").write_text("{}")
    sim_recording.remove_dataset(dataset)
    assert not dataset.exists()
    sim_recording.remove_dataset(dataset)
