"""Our datasets in LeRobot's own hands: loaded, every picture decoded, trained on; and what was
trained on them runs on the robot they are of."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strands_actors import Robot, record_dataset
from strands_actors.surfaces.dataset.compact import compact
from strands_actors.surfaces.dataset.dataset import Dataset
from strands_actors.surfaces.dataset.editing import label, merge, split
from tests.answers import json_of, task, task_ended, until
from tests.dataset.made import FPS, LAYOUT, add_episode, bar, row

from .commands import run

pytestmark = pytest.mark.filterwarnings("ignore:The video decoding and encoding capabilities of torchvision")
"""Which 0.4.4 decodes with, where it is told PyAV."""
LONG_S = 240.0
"""For another process to import torch, on a busy machine."""
FRAMES = (20, 31, 7)
TASKS = ("put the cube down", "wave", "put the cube down")
CAMERA: dict[str, dict[str, Any]] = {"front": {"type": "scene", "fps": 10, "width": 128, "height": 96}}
SMALL_ACT = (
    "--policy.type=act", "--policy.dim_model=32", "--policy.n_heads=2", "--policy.dim_feedforward=64",
    "--policy.n_encoder_layers=1", "--policy.n_vae_encoder_layers=1", "--policy.latent_dim=8",
)  # fmt: skip
"""LeRobot's chunk of 100 actions is 3.3 s: on a busy machine an inference may take half of them."""
HZ, RUNS_S = 30, 4.0


def as_it_is(root: Path, _: Path) -> Path:
    return root


def compacted(root: Path, into: Path) -> Path:
    compact(root, into)
    return into


def edited(root: Path, into: Path) -> Path:
    """Split it, label a part, and merge the parts: the same frames again."""
    first, second, named = (into.with_name(name) for name in ("first", "second", "named"))
    split(root, {first: "0-1", second: "2"})
    label(second, named, "all", task=TASKS[2], mark="failed")
    merge([first, named], into)
    return into


@pytest.mark.parametrize("form", [as_it_is, compacted, edited])
def test_every_frame_is_loaded_and_decoded(tmp_path: Path, form: Callable[[Path, Path], Path]) -> None:
    made = Dataset(tmp_path / "set")
    for frames, words in zip(FRAMES, TASKS, strict=True):
        add_episode(made, frames, words)
    made.close()
    data = opened(form(tmp_path / "set", tmp_path / "compacted"))
    assert data.num_episodes == len(FRAMES) and len(data) == data.num_frames == sum(FRAMES)
    each = iter(range(len(data)))
    for episode, frames in enumerate(FRAMES):
        for number in range(frames):
            frame = data[next(each)]
            given = row(number)
            assert frame["episode_index"] == episode and frame["task"] == TASKS[episode]
            assert frame["timestamp"].item() == np.float32(number / FPS)
            assert frame["observation.state"].tolist() == pytest.approx(given.state)
            assert frame["action"].tolist() == pytest.approx(given.action)
            assert frame["requested_action"].tolist() == pytest.approx(given.requested)
            for camera in LAYOUT.cameras:
                picture = frame[f"observation.images.{camera.name}"]
                assert tuple(picture.shape) == (3, camera.height, camera.width)
                column = bar(camera, number)
                assert picture[:, :, column + 2 : column + 6].mean() > 0.7, (camera.name, number)


def opened(root: Path) -> Any:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset("local/set", root=root, video_backend="pyav")


def test_what_a_twin_recorded_is_trained_on_and_drives_it_at_its_rate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    recorded(tmp_path / "swing")
    data = opened(tmp_path / "swing")
    assert len(data) == sum(1 for _ in (data[at] for at in range(len(data)))) > 20
    code, said = run(
        "train", tmp_path, "--dataset.repo_id=local/swing", f"--dataset.root={tmp_path / 'swing'}",
        "--dataset.video_backend=pyav", *SMALL_ACT, "--policy.pretrained_backbone_weights=null",
        "--policy.push_to_hub=false", "--policy.device=cpu", "--steps=1", "--batch_size=2", "--num_workers=0",
        f"--output_dir={tmp_path / 'trained'}",
    )  # fmt: skip
    assert code == 0, said
    checkpoint = tmp_path / "trained" / "checkpoints" / "last" / "pretrained_model"
    config = json.loads((checkpoint / "config.json").read_text())
    assert config["type"] == "act"
    assert set(config["input_features"]) == {"observation.state", "observation.images.front"}
    assert set(config["output_features"]) == {"action"}
    at_its_rate({"pretrained_name_or_path": str(checkpoint)})


def looking() -> Any:
    """A robot that has a camera, of its twin's scene."""
    return Robot("so101", mode="real", transport="twin", cameras=CAMERA)


def recorded(root: Path) -> None:
    with looking() as arm, record_dataset(arm, str(root), task="swing", fps=10, cameras=["front"]) as recording:
        until(lambda: json_of(arm.get_status())["cameras"]["front"]["state"] == "streaming", "it sees", LONG_S)
        for _ in range(2):
            with recording.episode():
                began_s = time.monotonic()
                while (since_s := time.monotonic() - began_s) < 4.0:
                    arm.send_action({"shoulder_pan": 10.0 * math.sin(since_s)})
                    time.sleep(0.02)


def at_its_rate(asked: Mapping[str, Any], hz: int = HZ) -> None:
    """A checkpoint drives the twin."""
    with looking() as arm:
        given = {"policy_provider": "lerobot_local", "units": "degrees", "control_frequency": hz, **asked}
        until(lambda: arm.connect_eagerly() is None, "it connects", LONG_S)
        json_of(arm.start_task("swing", duration=LONG_S, **given))
        until(lambda: task(arm)["steps"] or not task(arm)["running"], "it moves", LONG_S)
        began_s, steps = time.monotonic(), task(arm)["steps"]
        time.sleep(RUNS_S)
        told = task(arm)
        assert told["running"], (told["exit_detail"], told)
        seen_hz = (told["steps"] - steps) / (time.monotonic() - began_s)
        print(f"{seen_hz:.1f} steps/s of {hz}")
        assert seen_hz > hz / 4, told  # the machine may be busy
        json_of(arm.stop_task())
        assert task_ended(arm)["exit_reason"] == "stopped"
