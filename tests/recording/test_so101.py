"""The command records an SO-101 twin from a separate process, and the recording is replayed."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.session.portal import portal
from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import Node
from strands_actors.supervisors.gate import lease
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import Acquire, Lease, Setpoint, Stop, StopReport
from strands_actors.supervisors.instrument import SILENT_S
from strands_actors.surfaces import cli
from strands_actors.surfaces.recording import RecordingError, read, record, replay
from strands_actors.surfaces.recording.code import build_driver
from strands_actors.testing import WireLog
from tests.answers import pids, until
from tests.trees import armed

PATIENCE_S = 60.0
PROGRAM = "from strands_actors.surfaces.cli import main; main()"
REPLAYS = 100
COMMAND = "strands_actors.surfaces.cli.record"
"""Imported by name, because the package has a function with the name of the module."""


@contextlib.contextmanager
def recorder(path: Path, *arguments: str, **keywords: Any) -> Iterator[subprocess.Popen[str]]:
    """Yield a running ``strands-actors record so101``."""
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, "record", "so101", "-o", str(path), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        **keywords,
    ) as process:
        try:
            assert process.stderr is not None
            assert process.stderr.readline().startswith("recording so101"), process.communicate()
            yield process
        finally:
            process.kill()


def end(process: subprocess.Popen[str], how: signal.Signals = signal.SIGINT) -> tuple[str, str]:
    process.send_signal(how)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    return out, err


def ask(message: Message) -> Message | None:
    """Send a message as another writer in this process."""

    async def ask() -> Message | None:
        node: Node = portal().node
        sender = f"{node.address}/intruder"
        return await node.ref("strands/so101/actor/gate", Gate, sender=sender).ask(message, 5.0)

    return portal().call(ask)


def steps_of(arm: RealRobot) -> int:
    task = arm.get_task_status()["content"][0]["json"]
    return int(task["steps"]) if task["running"] else -1


def roll_out(arm: RealRobot, steps: int) -> None:
    """Run a policy in a separate process. On a busy machine the policy or the wire process may be late and end.
    Then start it again."""

    def far_enough() -> bool:
        if steps_of(arm) < 0:
            armed(arm)
            arm.start_task("wave", policy_provider="mock", duration=60.0)
        return steps_of(arm) >= steps

    until(far_enough, "the policy runs", PATIENCE_S)


def move(arm: RealRobot, times: int) -> None:
    for at in range(times):
        answer = arm.send_action({"gripper": 20.0 + at % 5})
        assert answer["status"] == "success", answer
        time.sleep(0.01)


def until_recorded(path: Path, arm: RealRobot) -> None:
    """Send commands until some must be in the file. Without a recorder the file would not grow so much."""
    size = path.stat().st_size
    until(
        lambda: arm.send_action({"gripper": 20.0})["status"] == "success" and path.stat().st_size > size + 30_000,
        "it is recorded again",
        PATIENCE_S,
    )
    move(arm, 20)


def rows(path: Path) -> dict[str, list[dict[str, Any]]]:
    found: dict[str, list[dict[str, Any]]] = {}
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            found.setdefault(channel.topic, []).append(json.loads(message.data))
    return found


def lively(arm: RealRobot) -> None:
    """Cause setpoints, refusals, a policy run, a second writer, stop, resume, e-stop and an expired lifetime."""
    for value in (5.0, 6.0):
        assert arm.send_action({"shoulder_pan": value})["status"] == "success"
    for wrong in ({"shoulder_pan": 400.0}, {"elbow": 1.0}, {"gripper": float("nan")}, {}):
        assert arm.send_action(wrong)["status"] == "error"
    intruder = ask(Acquire("an intruder"))
    assert isinstance(intruder, Refused) and intruder.code == "lease"
    assert isinstance(ask(Setpoint(1, 1, 0, {"shoulder_pan": 1.0})), Refused)
    roll_out(arm, 20)
    assert arm.stop_task()["status"] == "success"
    assert arm.send_action({"wrist_roll": 3.0})["status"] == "success"
    stopped = arm.stop()
    assert stopped["status"] == "success"  # type: ignore[index]
    assert arm.send_action({"wrist_roll": 3.0})["status"] == "error"
    assert arm.resume()["status"] == "success"
    report = ask(Stop(Reason.ESTOP, "op", lock=True))
    assert isinstance(report, StopReport) and report.confirmed
    assert arm.send_action({"wrist_roll": 3.0})["status"] == "error"
    assert arm.resume()["status"] == "success"
    arm.run_policy(lambda seen: {"gripper": seen["gripper"] + 0.2}, n_steps=10)
    until(lambda: steps_of(arm) < 0, "the rollout ends", PATIENCE_S)
    lease = ask(Acquire("an intruder"))
    assert isinstance(lease, Lease | Refused)


@pytest.fixture(scope="module")
def run(run_dirs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, str]]:
    """Record a lively run, begun while the arm moved. Return the file and the output of the command."""
    directory = tmp_path_factory.mktemp("recorded")
    path = directory / "run.mcap"
    meeting = Path("/tmp") / f"sa-rec-{os.getpid()}"
    run_dirs.append(meeting)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STRANDS_ACTORS_RUN", str(meeting))
        with Robot("so101", mode="real", transport="twin") as arm:
            assert arm.send_action({"shoulder_pan": 3.0})["status"] == "success"
            with recorder(path) as process:
                lively(arm)
                out, _ = end(process)
    yield path, out


@pytest.mark.long
def test_a_hundred_replays_differ_in_nothing(run: tuple[Path, str]) -> None:
    recording = read(run[0])
    driver = build_driver(recording.info)
    outcomes = [replay(recording, driver) for _ in range(REPLAYS)]
    assert all(outcome.equal for outcome in outcomes), next(o.difference for o in outcomes if not o.equal)
    assert outcomes.count(outcomes[0]) == REPLAYS
    assert outcomes[0].gaps == 0 and outcomes[0].skipped == 0
    assert outcomes[0].steps > 300


def test_everything_is_in_the_file(run: tuple[Path, str]) -> None:
    path, out = run
    seen = rows(path)
    assert all(topic.startswith("/so101/") for topic in seen)
    commands = Counter((row["what"], row["outcome"]) for row in seen["/so101/command"])
    assert commands["setpoint", "accepted"] > 10, "a busy machine may make some of them late"
    assert {code for row in seen["/so101/refusal"] if (code := row["code"])} >= {
        "past_travel", "unknown_joint", "not_finite", "empty", "lease", "disarmed", "locked_out",
    }  # fmt: skip
    reasons = [row["reason"] for row in seen["/so101/safe"] if row["what"] == "ordered"]
    assert {"stop", "estop"} <= set(reasons)
    assert all(row["confirmed"] for row in seen["/so101/safe"] if row["what"] == "done")
    happened = [row["what"] for row in seen["/so101/lifecycle"]]
    assert {
        "state",
        "armed",
        "lease granted",
        "the policy process was started",
        "the policy process has ended",
    } <= set(happened)
    axes = set(seen["/so101/observation"][0]["position"])
    assert axes == {"shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"}
    assert "/so101/gap" not in seen
    assert out.count("\n") == 1 and "no gaps" in out and "interrupted" in out


def test_the_command_replays(run: tuple[Path, str], capsys: pytest.CaptureFixture[str]) -> None:
    path, _ = run
    assert cli.run(["replay", str(path)]) == 0
    output = capsys.readouterr()
    assert output.out.startswith(f"{path}: equal. ") and output.err == ""
    assert cli.run(["replay", str(path), "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert plain["equal"] and plain["mismatch"] == "" and plain["difference"] is None and plain["robot"] == "so101"


def test_a_changed_limit_is_found(run: tuple[Path, str]) -> None:
    recording = read(run[0])
    driver = build_driver(recording.info)
    driver.gates = tuple(
        check for check in driver.gates if check.__name__ not in ("outside_reported_range", "jumps")
    )
    difference = replay(recording, driver).difference
    assert difference is not None and "{shoulder_pan: 400.0}" in difference.message
    assert any("past_travel" in effect for effect in difference.recorded)
    assert any("Write" in effect for effect in difference.replayed)


def test_the_command_shows_the_first_difference(
    run: tuple[Path, str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, _ = run
    monkeypatch.setattr(lease, "_MAX_LIFETIME_NS", 50_000_000)
    monkeypatch.setattr(import_module(COMMAND), "__version__", "9.9.9")
    assert cli.run(["replay", str(path)]) == 1
    output = capsys.readouterr()
    assert "recorded by strands-actors 0.1.0, replayed by 9.9.9" in output.err
    head, takes, *effects = output.out.splitlines()
    assert "DIFFERENT after" in head and "gate takes Setpoint(" in takes
    assert any(line.startswith("  recorded: answers: Accepted") for line in effects)
    assert any(line.startswith("  replayed: answers: Refused(code='too_distant'") for line in effects)
    assert cli.run(["replay", str(path), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["difference"]["actor"] == "gate"


def test_other_code_is_named(
    run: tuple[Path, str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(import_module(COMMAND), "fingerprint", lambda driver: "0badc0de0bad")
    assert cli.run(["replay", str(run[0])]) == 0
    assert "recorded by other code" in capsys.readouterr().err


def test_bad_files_are_one_line(run: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(run[0].read_bytes()[:-100])
    for path, says in ((cut, "is truncated"), (tmp_path / "none.mcap", "No such file")):
        assert cli.run(["replay", str(path)]) == 2
        output = capsys.readouterr()
        assert says in output.err and output.err.count("\n") == 1 and output.out == ""


# -- the robot does not notice its recorder


def test_saf_006_a_frozen_recorder_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The wire drops the recorder, the arm moves on, and a stop is as quick as before. When the recorder runs
    again, it continues after a gap."""
    log = WireLog(tmp_path / "wire.ndjson")
    monkeypatch.setenv("STRANDS_ACTORS_TWIN_LOG", str(log.path))
    path = tmp_path / "run.mcap"
    with Robot("so101", mode="real", transport="twin") as arm, recorder(path) as process:
        wire = pids(arm)["wire"]
        process.send_signal(signal.SIGSTOP)
        frozen_ns = time.monotonic_ns()
        while time.monotonic_ns() < frozen_ns + (SILENT_S + 0.5) * 1e9:
            move(arm, 10)
        setpoints = [entry.t_ns for entry in log.host("setpoint", frozen_ns)]
        assert len(setpoints) > 50
        assert arm.stop()["status"] == "success"  # type: ignore[index]
        assert log.safe_within(setpoints[-1], 2.0)
        assert pids(arm)["wire"] == wire, "the wire process was not fenced"
        process.send_signal(signal.SIGCONT)
        arm.resume()
        until_recorded(path, arm)
        end(process)
    outcome = replay(read(path))
    assert outcome.equal, outcome.difference
    assert outcome.gaps >= 1
    assert [row["source"] for row in rows(path)["/so101/gap"]].count("wire") >= 1


@pytest.mark.long
def test_a_killed_recorder_changes_nothing_and_another_may_begin(tmp_path: Path) -> None:
    with Robot("so101", mode="real", transport="twin") as arm:
        with recorder(tmp_path / "one.mcap") as process:
            assert "already records this robot" in refused_recorder(tmp_path / "two.mcap")
            wire = pids(arm)["wire"]
            move(arm, 5)
            process.kill()
            move(arm, 50)
            process.wait()
        assert pids(arm)["wire"] == wire

        def begin() -> bool:
            path = tmp_path / f"{time.monotonic_ns()}.mcap"
            with contextlib.suppress(RecordingError), record(arm, path):
                arm.stop()
                return True
            return False

        until(begin, "the robot gives the dead one up", PATIENCE_S)
    with pytest.raises(RecordingError, match="truncated"):
        read(tmp_path / "one.mcap")
    whole = max(tmp_path.glob("[0-9]*.mcap"), key=lambda path: path.name)
    assert replay(read(whole)).equal


def refused_recorder(path: Path) -> str:
    """Return the message of a recorder that is refused."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, "record", "so101", "-o", str(path)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and done.stdout == ""
    assert not path.exists()
    return done.stderr


def test_the_death_of_the_wire_is_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with Robot("so101", mode="real", transport="twin") as arm, recorder(path) as process:
        assert arm.send_action({"gripper": 30.0})["status"] == "success"
        wire = pids(arm)["wire"]
        os.kill(wire, signal.SIGKILL)
        until(lambda: pids(arm).get("wire", wire) != wire, "a new wire", PATIENCE_S)
        assert arm.resume()["status"] == "success"
        until_recorded(path, arm)
        assert arm.send_action({"gripper": 20.0})["status"] == "success"
        after = rows_when_ended(process, path)
    happened = [(row["what"], row["detail"]) for row in after["/so101/lifecycle"]]
    ended = ("the wire has ended", "the wire process ended with signal 9")
    assert ended in happened
    assert any(what == "the wire process was started" for what, _ in happened[happened.index(ended) :])
    (second,) = [row for row in after["/so101/safe"] if row["path"] == "stop_channel"]
    assert second["confirmed"] and second["safe_state"] == "limp" and len(second["motors"]) == 6
    assert [row["source"] for row in after["/so101/gap"]] == ["wire"]
    last = after["/so101/command"][-1]
    assert (last["what"], last["outcome"], last["action"]) == ("setpoint", "accepted", {"gripper": 20.0})
    outcome = replay(read(path))
    assert outcome.equal and outcome.gaps == 1


def rows_when_ended(process: subprocess.Popen[str], path: Path) -> dict[str, list[dict[str, Any]]]:
    end(process, signal.SIGTERM)
    return rows(path)


@pytest.mark.long
def test_a_full_disk_ends_the_recording_and_nothing_else(tmp_path: Path) -> None:
    def small_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))

    with Robot("so101", mode="real", transport="twin") as arm:
        with recorder(tmp_path / "run.mcap", preexec_fn=small_disk) as process:
            while process.poll() is None:
                move(arm, 10)
            out, err = process.communicate(timeout=PATIENCE_S)
            assert process.returncode == 2 and out == "" and "File too large" in err
        move(arm, 10)


@pytest.mark.long
def test_a_recording_ends_with_the_robot(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with Robot("so101", mode="real", transport="twin") as arm:
        arm.send_action({"gripper": 30.0})
        with recorder(path, "--json") as process:
            arm.cleanup()
            out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    assert json.loads(out)["ended"] == "the robot is gone"
    seen = rows(path)
    assert [row["reason"] for row in seen["/so101/safe"] if row["what"] == "ordered"] == ["cleanup"]
    assert ("shutdown", "cleanup") in [(row["what"], row["cause"]) for row in seen["/so101/lifecycle"]]
    assert replay(str(path)).equal  # by its name, as text or as a path
    assert replay(path) == replay(read(str(path)))


def test_a_robot_that_cannot_be_recorded_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cli.run(["record", "so101", "-o", str(tmp_path / "run.mcap")]) == 2
    assert "no robot 'so101' of this user is running" in capsys.readouterr().err
    there = tmp_path / "there.mcap"
    there.write_text("mine")
    assert cli.run(["record", "so101", "-o", str(there)]) == 2
    assert "exists already" in capsys.readouterr().err and there.read_text() == "mine"
    assert cli.run(["record", "so101", "-o", str(tmp_path / "no" / "run.mcap")]) == 2
    assert f"the folder {tmp_path / 'no'} does not exist" in capsys.readouterr().err
    with pytest.raises(RecordingError, match="no robot"), record("so101", tmp_path / "run.mcap"):
        raise AssertionError("nothing is recorded")
    assert list(tmp_path.iterdir()) == [there]
