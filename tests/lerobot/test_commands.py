"""``lerobot-teleoperate``, ``-record`` and ``-replay``, unmodified, with our robots: what the twin's
log shows of them."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from strands_actors.testing import Twin
from tests.answers import until

from .commands import RUN_S, SINE, run, start
from .frames import goals

COUNTS_PER_DEGREE = 4095 / 360
MIDDLE = 2048
PAN = 1
"""The id of its servo."""
SWING = 10.0 * COUNTS_PER_DEGREE + 2
BOUND_S = 0.05 + 0.5
"""The robot's published bound, and room for a busy machine."""


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("so101", tmp_path) as twin:
        yield twin


def ours(twin: Twin) -> tuple[str, ...]:
    return "--robot.type=strands_so101", f"--robot.port={twin.port}"


def test_teleoperate_moves_the_twin_and_leaves_it_limp(twin: Twin, tmp_path: Path) -> None:
    code, said = run("teleoperate", tmp_path, *ours(twin), *SINE, "--fps=30", "--teleop_time_s=4")
    assert code == 0, said
    swung = list(goals(twin.log, PAN))
    assert len(swung) > 60 and max(swung) - MIDDLE > 0.7 * SWING  # 4 s of a sine are past its top
    assert all(abs(goal - MIDDLE) <= SWING for goal in swung)
    _limp_at_the_end(twin)


def test_saf_014_400_degrees_are_refused_and_never_on_the_wire(twin: Twin, tmp_path: Path) -> None:
    code, said = run(
        "teleoperate", tmp_path, *ours(twin), *SINE, "--teleop.past=true", "--fps=30", "--teleop_time_s=3"
    )
    assert code == 0, said
    assert "400.0 deg is past" in said
    swung = list(goals(twin.log, PAN))
    assert len(swung) > 40 and all(abs(goal - MIDDLE) <= SWING for goal in swung)
    _limp_at_the_end(twin)


def test_actions_that_are_refused_for_long_end_the_command(twin: Twin, tmp_path: Path) -> None:
    code, said = run(
        "teleoperate", tmp_path, *ours(twin), "--robot.refusals=5", *SINE, "--teleop.past=true", "--fps=30"
    )
    assert code != 0 and "5 actions in a row were refused, the last: move: shoulder_pan 400.0 deg" in said
    _limp_at_the_end(twin)


def test_saf_003_teleoperate_is_killed_and_the_torque_is_off(twin: Twin, tmp_path: Path) -> None:
    process = start("teleoperate", tmp_path, *ours(twin), *SINE, "--fps=30")
    try:
        until(lambda: process.poll() is not None or list(goals(twin.log, PAN))[20:], "it moves", RUN_S)
        killed_ns = time.monotonic_ns()
        process.kill()
        until(lambda: twin.log.first_safe(killed_ns), "it is limp")
    finally:
        process.kill()
        said, _ = process.communicate()
    safe = twin.log.first_safe(killed_ns)
    assert safe is not None and safe.safe_state == "limp", said
    twin.log.safe_within(killed_ns, BOUND_S)
    twin.log.no_setpoint_after_safe(killed_ns)


def test_what_record_records_replay_plays(twin: Twin, tmp_path: Path) -> None:
    dataset = ("--dataset.repo_id=somebody/swing", f"--dataset.root={tmp_path / 'swing'}")
    code, said = run(
        "record", tmp_path, *ours(twin), *SINE, *dataset, "--dataset.single_task=swing", "--dataset.fps=30",
        "--dataset.num_episodes=2", "--dataset.episode_time_s=3", "--dataset.reset_time_s=1",
        "--dataset.push_to_hub=false", "--play_sounds=false",
    )  # fmt: skip
    assert code == 0, said
    _limp_at_the_end(twin)
    frames = frames_of(tmp_path / "swing", tmp_path)
    assert 120 < frames <= 182
    replayed_ns = time.monotonic_ns()
    code, said = run("replay", tmp_path, *ours(twin), *dataset, "--dataset.episode=0", "--play_sounds=false")
    assert code == 0, said
    swung = list(goals(twin.log, PAN, replayed_ns))
    assert len(swung) > 60 and max(swung) - MIDDLE > 0.7 * SWING
    assert all(abs(goal - MIDDLE) <= SWING for goal in swung)
    _limp_at_the_end(twin)


def frames_of(root: Path, home: Path) -> int:
    """Return how many frames LeRobot itself counts."""
    script = (
        "import sys; from lerobot.datasets.lerobot_dataset import LeRobotDataset; "
        "data = LeRobotDataset('somebody/swing', root=sys.argv[1]); "
        "assert data.features['action']['names'][0] == 'shoulder_pan.pos', data.features; "
        "print('frames', len(data))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(root)],
        capture_output=True,
        text=True,
        env={"HF_HOME": str(home), "HF_HUB_OFFLINE": "1", "PATH": "/usr/bin:/bin"},
    )
    assert done.returncode == 0, done.stderr
    return int(done.stdout.rpartition("frames ")[2])


def _limp_at_the_end(twin: Twin) -> None:
    """The last that the host wrote of setpoints and safe frames brought all servos to rest."""
    told = [one for one in twin.log.entries() if one.sender == "host" and one.kind in ("setpoint", "safe")]
    assert told[-1].kind == "safe" and "limp" in [one.safe_state for one in told[-12:]]
