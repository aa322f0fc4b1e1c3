"""``strands-actors eval``: episodes that repeat, scenes with random parts, results and films."""

from __future__ import annotations

import json
import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.sim_robot import SimRobot
from strands_actors.simulation import scenes
from strands_actors.simulation.episodes import DrawnCamera, Ended, Episode, Moment, Settings, run_episode
from strands_actors.surfaces.cli import run
from strands_actors.surfaces.cli.evaluate import _Simulation
from tests.answers import json_of, why

HERE = "tests.cli.test_evaluate"


def lift(sim: SimRobot, draw: random.Random) -> Mapping[str, float]:
    return {"shoulder_pan": draw.uniform(5.0, 20.0)}


def lowered(moment: Moment) -> bool:
    return moment.positions["shoulder_lift"] > 10.0


def creep(seen: Mapping[str, float]) -> Mapping[str, float]:
    if seen["shoulder_pan"] > 14.0:
        raise LookupError("no plan for this pose")
    return {"shoulder_lift": seen["shoulder_lift"] + 3.0}


class Creep:
    def __init__(self, axes: list[str]) -> None:
        self.step = creep


def test_each_episode_has_its_seed_and_its_own_end(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    functions = ["--success", f"{HERE}:lowered", "--scene", f"{HERE}:lift"]
    length = ["--episodes", "2", "--seconds", "2", "--seed", "1", "--out", str(tmp_path)]
    code = run(["eval", "so101", "--policy", f"{HERE}:Creep", *functions, *length, "--json"])
    report = json.loads(capsys.readouterr().out)
    first, second = report["episodes"]
    # The start poses are 7.0 and 19.3 degrees. The policy has no plan for the second one.
    assert (first["seed"], first["ended"], first["success"]) == (1, "success", True)
    assert (second["seed"], second["ended"]) == (2, "policy") and "no plan for this pose" in second["detail"]
    assert (report["success_rate"], code) == (0.5, 1)
    assert json.loads((tmp_path / "results.json").read_text()) == report


def no_end(moment: Moment) -> bool:
    return False


def episode(number: int, policy: Any, seconds: float, **settings: Any) -> tuple[Episode, list[Moment]]:
    moments: list[Moment] = []
    with Robot("so101") as robot:
        assert isinstance(robot, SimRobot)
        driver = robot.driver
        chosen: dict[str, Any] = {"scene": scenes.cube, "videos": None, **settings}
        success = lambda moment: moments.append(moment)  # noqa: E731
        all_settings = Settings(driver.axes, driver.table, 30.0, seconds, "", success=success, **chosen)
        return run_episode(_Simulation(robot), policy, all_settings, number, 7), moments


def test_an_episode_repeats_to_the_last_digit_and_a_failure_is_filmed(run_dir: Path, tmp_path: Path) -> None:
    def turn(seen: Mapping[str, float]) -> Mapping[str, float]:
        return {"shoulder_pan": seen["shoulder_pan"] + 2.0}

    done, moments = episode(3, turn, 0.5, videos=tmp_path)
    again, moments_again = episode(3, turn, 0.5)
    assert (done.ended, done.steps, done.detail) == (Ended.TIME, 15, "0.5 s have passed")
    assert moments == moments_again and len(moments) == 15
    assert moments[0].start["cube"][2] == pytest.approx(moments[-1].objects["cube"][2], abs=0.01)
    assert done._replace(video="") == again
    assert Path(done.video).name == "episode-003.mp4" and Path(done.video).stat().st_size > 500


def test_a_refused_action_ends_the_episode(run_dir: Path) -> None:
    done, moments = episode(0, lambda seen: {"shoulder_pan": 400.0}, 1.0, scene=None)
    assert (done.ended, done.success, moments) == (Ended.REFUSED, False, [])
    assert "shoulder_pan 400.0 deg is past" in done.detail


def test_light_objects_and_drawn_cameras(run_dir: Path) -> None:
    with Robot("so101") as sim:
        assert isinstance(sim, SimRobot)
        scenes.cube(sim, random.Random(1))
        assert json_of(sim.get_objects())["cube"]["position"][2] == pytest.approx(0.02, abs=0.01)
        camera = DrawnCamera("eye", (64, 48), "scene", lambda: sim)
        json_of(sim.set_light(brightness=1.0))
        bright = camera.newest().image
        json_of(sim.set_light(brightness=0.1, azimuth=90.0, elevation=80.0))
        assert bright.shape == (48, 64, 3) and camera.newest().image.mean() < bright.mean()
        assert "Give a number from 0" in why(sim.set_light(brightness=-1.0))
        assert "above 0 and at most 90" in why(sim.set_light(elevation=0.0))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--success", "nowhere:at_all"], "--success is 'nowhere:at_all'"),
        (["--success", f"{HERE}:HERE"], "which is no function"),
        (["--success", f"{HERE}:no_end", "--policy", "smooth_talk"], "is no policy's name"),
    ],
)
def test_what_cannot_begin_says_why(arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["eval", "so101", "--policy", "mock", *arguments]) == 2
    assert text in capsys.readouterr().err
