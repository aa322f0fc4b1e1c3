"""The pictures of the documentation are made by the code, of the robots' own twins."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from docs.site import facts, sources
from docs.site.build import ROOT
from docs.studio import command, console, demo, robots, terminal
from docs.studio.camera import visible_points
from docs.studio.light import Studio
from docs.studio.watching import Seen
from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.kernel.clock import NS
from strands_actors.surfaces.cli.demo.scenario import Outcome
from strands_actors.surfaces.cli.demo.watch import Sample

PICTURES = ROOT / "docs" / "pictures"
WIDTH, HEIGHT = 160, 120
DRAWN_GROUPS = 3
"""MuJoCo draws the groups below this one. A robot with looks has its shapes in another."""
MEASURED = {"fleet.svg"}
"""Curves that ``python -m benchmarks.sides.scale --write`` draws."""

FIRST = ("so101", "unitree_g1", "crazyflie")
"""Robots of different kinds: a fixed arm, a walking robot on its feet, a flying robot."""


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize("robot", [*FIRST, *(name for name in facts.robots() if name not in FIRST)])
def test_the_picture_of_a_robot_shows_all_of_it_on_the_floor(robot: str) -> None:
    scene, table = robots.scene_of(robot), robots.poses().get(robot, {})
    picture = robots.portrait(scene, table, 2, WIDTH, HEIGHT)
    assert picture.shape == (HEIGHT, WIDTH, 3)

    # The floor is pale. A shadow is darker, but not as dark as a robot's dark parts, and has no colour.
    channels = picture.astype(int)
    marked = (channels.max(axis=2) < 90) | (channels.max(axis=2) - channels.min(axis=2) > 60)
    rows, columns = np.flatnonzero(marked.any(axis=1)), np.flatnonzero(marked.any(axis=0))
    share = max((rows[-1] - rows[0] + 1) / HEIGHT, (columns[-1] - columns[0] + 1) / WIDTH)
    assert 0.3 < share < 1.0, "the robot fills the picture and is not cut off"
    assert 0.005 < marked.mean() < 0.6

    studio = Studio(scene.file, WIDTH, HEIGHT, 1)
    studio.close()
    model = studio.model
    drawn = (model.geom_group < DRAWN_GROUPS) & (model.geom_bodyid > 0)
    assert drawn.sum() >= 5, "the robot has looks, or its shapes are drawn"
    pose = robots.posed(model, scene.qpos, table.get("joints", {}))
    points = robots.points_in(model, pose)
    if table.get("grounded", True):
        robots.put_on_floor(model, pose, points)
        assert robots.points_in(model, pose)[:, 2].min() == pytest.approx(0.0, abs=1e-6)
    for name, value in table.get("joints", {}).items():
        if name != "base_z" and model.joint(name).range.any():
            low, high = model.joint(name).range
            assert low - 1e-3 <= value <= high + 1e-3, f"{name} of the pose is in its range"


def test_the_lowest_points_of_a_walking_robot_are_its_feet() -> None:
    scene = robots.scene_of("unitree_g1")
    studio = Studio(scene.file, WIDTH, HEIGHT, 1)
    studio.close()
    data = mujoco.MjData(studio.model)
    data.qpos[:] = scene.qpos
    mujoco.mj_kinematics(studio.model, data)
    lowest = {
        studio.model.body(int(studio.model.geom_bodyid[geom])).name: None
        for geom in range(studio.model.ngeom)
        if studio.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH
        and data.geom_xpos[geom, 2] < visible_points(studio.model, data)[:, 2].min() + 0.03
    }
    assert set(lowest) == {"left_ankle_roll", "right_ankle_roll"}


def test_each_robot_has_its_picture_and_all_are_small() -> None:
    for robot in facts.robots():
        file = PICTURES / f"{robot}.png"
        assert file.is_file(), f"run: python -m docs pictures {robot}"
        with Image.open(file) as picture:
            assert picture.size == (robots.WIDTH, robots.HEIGHT)
        assert file.stat().st_size < 80_000
    assert (PICTURES / "demo.gif").stat().st_size < 3_000_000
    assert sum(file.stat().st_size for file in PICTURES.iterdir()) < 6_000_000
    names = {
        *(f"{robot}.png" for robot in facts.robots()),
        *(file for file, _ in command.OTHERS.values()),
        *console.BESIDE,
        *MEASURED,
    }
    assert {file.name for file in PICTURES.iterdir()} == names
    assert set(robots.poses()) <= set(facts.robots())


def test_the_readme_and_the_site_find_their_pictures() -> None:
    readme = (ROOT / "README.md").read_text()
    shown = re.findall(r'<img src="([^"]+)"', readme)
    assert len(shown) > 15
    assert all((ROOT / path).is_file() for path in shown)
    for picture in ('<img src="docs/pictures/so101.png" width="1">', "![x](docs/pictures/so101.png)"):
        assert sources.relinked(picture, "index.md") == picture.replace("docs/", "")


def test_a_picture_that_does_not_exist_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        command.main(["so1001"])
    assert end.value.code == 2
    assert "there is no picture so1001. Use b2, bi_openarm, booster_t1" in capsys.readouterr().err


def test_the_command_writes_the_picture_that_was_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(command, "FOLDER", tmp_path / "pictures")
    assert command.main(["--samples", "1", "crazyflie"]) == 0
    assert [file.name for file in (tmp_path / "pictures").iterdir()] == ["crazyflie.png"]


def seen_demo() -> Seen:
    """Return a demo of two seconds with one fault, at second 0.5. The arm is energised again at second 1."""
    scene = robots.scene_of("so101")
    axes = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
    times = [index * NS // 50 for index in range(4 * 50)]
    poses = [Sample(t, scene.qpos) for t in times]
    positions = [Sample(t, tuple(10.0 * np.sin(t / NS + axis) for axis in range(6))) for t in times]
    outcome = Outcome("policy", "SIGKILL", 1, "hold", 50.0, struck_ns=2 * NS, safe_ns=2 * NS + 7_000_000)
    outcome.resumed_ns = int(2.5 * NS)
    targets = [sample for sample in positions if not outcome.struck_ns < sample.t_ns < 2.7 * NS]
    return Seen(scene.file, poses, axes, positions, targets, [outcome])


def test_the_animation_shows_the_fault_when_it_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "SAMPLES", 1)
    monkeypatch.setattr(demo, "FPS", 3)
    seen = seen_demo()
    times = demo.frame_times(seen)
    pictures = demo.draw(seen)
    assert len(pictures) == len(times) > 6
    red = tuple(int(demo.FAULT[index : index + 2], 16) for index in (1, 3, 5))
    for t_ns, picture in zip(times, pictures, strict=True):
        assert picture.shape == (demo.HEIGHT, demo.WIDTH, 3)
        plot = picture[60:-40, demo.TWIN :].astype(int)
        has_line = (np.abs(plot - red).sum(axis=2) < 60).sum() > 50
        assert has_line == (t_ns >= seen.outcomes[0].struck_ns)
    plot = demo.Plot(seen, times[0], times[-1])
    titles = [plot._caption(t_ns)[0] for t_ns in times]
    assert list(dict.fromkeys(titles))[:2] == ["A policy moves the arm", "SIGKILL to the policy process"]
    assert titles[-1] == "A new policy moves the arm"
    assert "hold after 7.0 ms" in plot._caption(2 * NS + NS // 10)[2]


def test_a_picture_of_the_terminal_loads_nothing_from_a_network() -> None:
    svg = '<style>@font-face { src: url("https://a.b/c"); } .x { font-family: Fira Code; }</style>'
    clean = terminal.without_fonts(svg)
    assert "http" not in clean
    assert ".x { font-family: ui-monospace" in clean
    for file in PICTURES.glob("*.svg"):
        assert not re.search(r"url\([^#]|href=\"[^#]|@import", file.read_text()), file.name
