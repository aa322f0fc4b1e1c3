"""The tree keeps its promises in every run that failed in the past, and in many random runs."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import msgspec
import pytest

from tests.explorer.kinds import TWIN_DATAGRAMS, TWIN_PORTS, TWIN_STREAMS
from tests.explorer.plan import Plan, plan_of
from tests.explorer.robots import ROBOTS
from tests.explorer.search import run_apart, run_here, run_seeds

RUNS = tomllib.loads((Path(__file__).parent / "seeds.toml").read_text())["run"]
SEEDS = {
    "so101": 250,
    "so101_lowered": 80,
    "xarm7": 250,
    "ur5e": 100,
    "ur5e_script": 100,
    "fake_queue": 100,
    "unitree_go2": 10,
    "fake_base": 500,
    "fake_drone": 390,
    "fake_http": 500,
    "rby1": 60,
    "spot": 60,
    "yahboom_m3pro": 100,
    "earthrover": 100,
    "kuka_iiwa": 100,
    "crazyflie": 100,
    "booster_t1": 40,
    "microduck": 60,
    "reachy_mini": 50,
    "kinova_gen3": 60,
    "robotiq_2f85": 200,
    "panda": 25,
    "stretch3": 40,
}
"""Number of seeds: 3 055, which take 400 s of one core. A run of legs takes ten times as long as another. One of an
SO-101 takes twice as long as a fake's, one of a panda ten times, and one of the other robots of the kit three
times. A search for new failures takes any number."""
QUICK = {
    "so101": 20,
    "so101_lowered": 10,
    "xarm7": 20,
    "ur5e": 10,
    "ur5e_script": 10,
    "fake_queue": 15,
    "unitree_go2": 3,
    "fake_base": 30,
    "fake_drone": 30,
    "fake_http": 30,
    "rby1": 4,
    "spot": 5,
    "yahboom_m3pro": 5,
    "earthrover": 6,
    "kuka_iiwa": 5,
    "crazyflie": 8,
    "booster_t1": 3,
    "microduck": 4,
    "reachy_mini": 4,
    "kinova_gen3": 4,
    "robotiq_2f85": 5,
    "panda": 2,
    "stretch3": 3,
}
"""Number of seeds in the ordinary run, a fifteenth of that time. The others belong to the long run."""
DRAWN = [
    *(pytest.param(robot, range(QUICK[robot]), id=robot) for robot in ROBOTS),
    *(
        pytest.param(robot, range(QUICK[robot], SEEDS[robot]), id=f"{robot}-others", marks=pytest.mark.long)
        for robot in ROBOTS
    ),
]
TWICE = {"so101": 3, **dict.fromkeys((*TWIN_STREAMS, *TWIN_DATAGRAMS, *TWIN_PORTS), 1)}
"""Number of seeds that are run in several processes."""
HASH = f"""
from tests.explorer.search import run_seeds
for robot, seeds in {TWICE}.items():
    print(*(result.digest for result in run_seeds(range(seeds), robot)))
"""


@pytest.mark.parametrize("run", RUNS, ids=[run["found"] for run in RUNS])
def test_a_repaired_failure_stays_repaired(run: dict[str, str]) -> None:
    (result,) = run_apart([msgspec.json.decode(run["plan"], type=Plan)])
    assert not result.violations


@pytest.mark.parametrize(("robot", "seeds"), DRAWN)
def test_no_drawn_run_breaks_a_promise(robot: str, seeds: range) -> None:
    broken = [result for result in run_seeds(seeds, robot) if result.violations]
    lines = [f"--robot {robot} --seed {result.plan.seed}: {result.violations[0]}" for result in broken]
    assert not broken, "\n".join(lines)


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_run_without_faults_moves_the_robot(robot: str) -> None:
    """Without this test, a robot that is never armed would keep every promise."""
    run = run_here(Plan(1, robot, "stream", ()))
    assert not run.violations
    assert sum(frame.kind == "setpoint" for frame in run.model.frames) > 15


def test_the_same_seed_is_the_same_run_in_another_process() -> None:
    """The run must not depend on the order of sets of strings, the addresses of objects, or the time of day."""
    histories = [
        subprocess.run(
            [sys.executable, "-c", f"held = [bytearray({size}) for _ in range(1000)]\n{HASH}"],
            env={**os.environ, "PYTHONHASHSEED": seed},
            check=True,
            capture_output=True,
            text=True,
        ).stdout.split()
        for seed, size in (("1", 10), ("2", 5000))
    ]
    here = [result.digest for robot, seeds in TWICE.items() for result in run_seeds(range(seeds), robot)]
    assert histories == [here, here]
    assert len(set(here)) == len(here), "another seed gives another run"


def test_a_run_depends_on_its_faults() -> None:
    plan = plan_of(0, "so101")
    one, other = run_apart([plan, msgspec.structs.replace(plan, events=plan.events[:-1])])
    assert one.digest != other.digest
