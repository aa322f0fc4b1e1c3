"""``run``: a policy by name on a simulation and a twin, Ctrl-C, and wrong arguments."""

from __future__ import annotations

import signal

import pytest

from strands_actors.surfaces.cli.errors import Problem
from strands_actors.surfaces.cli.options import settings_of
from tests.answers import until

from .command import PATIENCE_S, Command


def test_a_newcomer_runs_a_policy_without_a_robot(cli: Command) -> None:
    for _ in range(3):  # on a machine that pauses, a setpoint may expire
        done = cli.run("run", "so101", "--policy", "mock", "--seconds", "0.5")
        if done.returncode == 0:
            break
    assert done.returncode == 0, done.stdout + done.stderr
    assert (
        done.stdout.startswith("so101: mock: ")
        and "0 refused, " in done.stdout
        and done.stdout.endswith("; ended: duration\n")
    )
    assert " steps/s  newest reading " in done.stderr


def test_ctrl_c_ends_it_and_reports_what_happened(cli: Command) -> None:
    with cli.start("run", "so101", "--twin", "--policy", "mock", "--seconds", "60") as process:
        shown = process.stderr
        assert shown is not None
        until(lambda: "steps/s" in shown.readline(), "it runs", PATIENCE_S)
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert out.startswith("so101: mock: ") and out.endswith("; ended: stopped\n")


def test_a_wrong_policy_starts_nothing_and_is_one_line(cli: Command) -> None:
    done = cli.run("run", "so101", "--policy", "smock")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("strands-actors: run: 'smock' (mock?) is no policy's name")
    assert done.stderr.count("\n") == 1


def test_options_of_a_policy_are_json_or_text() -> None:
    texts = ["units=degrees", "amplitude=2.5", 'only=["gripper"]', "rtc=true", "a=b=c"]
    assert settings_of("run", texts) == {
        "units": "degrees",
        "amplitude": 2.5,
        "only": ["gripper"],
        "rtc": True,
        "a": "b=c",
    }
    for wrong, text in ((["units"], "'units' is not KEY=VALUE"), (["a=1", "a=2"], "--option a is given twice")):
        with pytest.raises(Problem, match=text):
            settings_of("run", wrong)
