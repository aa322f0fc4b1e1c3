"""The command answers a wrong call with one line and exit code 2."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from strands_actors.drivers import list_native_drivers
from strands_actors.surfaces.cli import run
from strands_actors.surfaces.cli.packages import missing_extras
from strands_actors.version import __version__

from .command import Command


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["twin", "so999", "--port-file", "port"], "so999"),
        (["twin", "so101", "--port-file", "port", "--fault", "sulk"], "sulk"),
        (["twin", "so101"], "--port-file"),
        (["stop", "nobody"], "nobody"),
        (["estop", "--all"], "no robot"),
        (["resume"], "--all"),
        (["stop", "one", "--all"], "no robot"),
        (["demo", "--seconds", "1"], "--seconds"),
        (["demo", "--out", "no/such/folder/demo.png"], "no/such/folder"),
        (["dance"], "dance"),
        (["echo", "strands/so101/"], "'strands/so101/' is not a valid key"),
        (["hz", "strands//x", "--seconds", "1"], "'strands//x' is not a valid key"),
        (["echo", "strands/#"], "'strands/#' is not a valid key"),
        (["mesh", "keys", "keys", "--days", "99999999"], "--days"),
        (["matrix", "-o", "no/such/page.md"], "does not exist"),
        (["calibrate", "nope", "--port", "x"], "`strands-actors list` has them all"),
        (["calibrate", "so11", "--port", "x"], "'so11' is not known (so101?)"),
        (["calibrate", "ur5e", "--port", "x"], "its maker calibrates it"),
        (["drill", "nope", "--twin", "--yes"], "`strands-actors list` has them all"),
        (["twin", "so101", "--port-file", "port", "--fault", "off:99"], "Use one of 1, 2, 3, 4, 5, 6"),
        (["send", "nobody", "x=1"], "nobody is not on the mesh"),
        (["mcp", "so101", "--id", "my arm"], "mcp: Robot: id is 'my arm'"),
        (["drill", "so101", "--twin", "--yes", "--id", "my arm"], "drill: Robot: id is 'my arm'"),
        (["drill", "so101", "--twin", "--yes", "--id", ""], "drill: Robot: id is ''"),
        (["record", "one", "-o", "a", "--dataset", "b"], "one of the two"),
        (["record", "one", "-o", "a", "--fps", "7", "--camera", "eye"], "--fps, --camera: of a dataset's episodes"),
        (["teleop", "so101", "--twin", "--port", "P", "--from", "keyboard"], "--port and --twin are both given"),
        (["estop", "one", "--all"], "no robot is on the mesh"),
        (["resume", "one", "--all"], "one and --all are both given"),
    ],
)
def test_one_line_and_exit_code_2(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    named: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "strands_actors.drivers.common.twin.process.run_first", lambda priority: None
    )  # not this one
    assert run(arguments) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.startswith("strands-actors: ")
    assert output.err.count("\n") == 1
    assert named in output.err


@pytest.mark.parametrize(
    "arguments",
    [
        ["demo", "--seconds"],
        ["echo", "one", "--timeout"],
        ["hz", "one", "--seconds"],
        ["trace", "one", "--seconds"],
        ["send", "one", "x=1", "--for"],
        ["record", "one", "-o", "run.mcap", "--seconds"],
        ["record", "one", "--dataset", "pick", "--seconds"],
        ["teleop", "so101", "--from", "keyboard", "--seconds"],
        ["teleop", "so101", "--from", "keyboard", "--hz"],
        ["teleop", "so101", "--from", "keyboard", "--max-speed"],
    ],
    ids=lambda arguments: f"{arguments[0]} {arguments[-1]}",
)
def test_nan_and_infinity_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for value in ("nan", "inf"):
        assert run([*arguments, value]) == 2
        output = capsys.readouterr()
        assert (output.out, output.err.count("\n")) == ("", 1)
        assert f"'{arguments[-1]}': {value} is not a finite number" in output.err
    assert list(tmp_path.iterdir()) == []


def test_help_names_every_command(cli: Command) -> None:
    for arguments in (["--help"], []):
        done = cli.run(*arguments)
        assert done.returncode == 0
        for command in ("demo", "list", "tree", "stop", "estop", "resume", "twin"):
            assert f"\n  {command} " in done.stdout


def test_list_shows_the_driver_of_each_robot(cli: Command) -> None:
    rows = {row["robot"]: row for row in cli.json("list", "--all")["robots"]}
    needed = "pip install 'lerobot[feetech]'"
    both = {"driver": "FeetechDriver", "coverage": ["lerobot", "strands"], "missing": needed}
    wire = {"wire": "feetech", "port": "serial", "twin": True}
    assert rows["so101"] == {"robot": "so101", **both, **wire, "experimental": {}}
    nobody = {"driver": None, "coverage": [], "missing": None, "wire": None, "port": None, "twin": False}
    assert rows["ability_hand"] == {"robot": "ability_hand", **nobody, "experimental": {}}
    drawn = cli.run("list", "--all").stdout
    assert all(robot in drawn for robot in rows)
    assert "lerobot: pip install" in drawn  # LeRobot could drive it, but is not installed here


def test_list_shows_first_the_robots_that_work_here(cli: Command) -> None:
    robots = {row["robot"] for row in cli.json("list")["robots"]}
    assert robots == set(list_native_drivers())
    others = [row for row in cli.json("list", "--all")["robots"] if row["robot"] not in robots]
    by_lerobot = sum(bool(row["coverage"]) for row in others)
    drawn = cli.run("list").stdout
    assert "ability_hand" not in drawn and "omx" not in drawn
    assert re.search(r"^ *so101 +feetech +serial +yes +strands *$", drawn, re.MULTILINE)
    assert f"\n{by_lerobot} more are driven by LeRobot, which is not installed: --all shows them\n" in drawn
    assert f"\n{len(others) - by_lerobot} more are known by name and have no driver: --all shows them\n" in drawn


def test_list_names_the_extras_that_are_not_installed(cli: Command) -> None:
    absent = cli.json("list")["not_installed"]
    assert absent == missing_extras()
    drawn = cli.run("list").stdout
    named = re.findall(r"^extra (\w+) is not installed: (.+)$", drawn, re.MULTILINE)
    assert dict(named) == absent


def test_list_names_the_experimental_ways_to_connect(cli: Command) -> None:
    drawn = cli.run("list").stdout
    ways = (
        "crazyflie, a port radio:// or usb://",
        "yahboom_m3pro, transport='ros2'",
        "simulations, backend='isaac'",
    )
    assert all(f"experimental: {way}" in drawn for way in ways)


def test_a_problem_is_the_exit_code_of_the_process(cli: Command) -> None:
    done = cli.run("resume", "one", "--all")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("strands-actors: ")


def test_version(cli: Command) -> None:
    done = cli.run("--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"strands-actors {__version__}\n", "")


@pytest.mark.parametrize(
    "arguments",
    [
        ["stop", "nobody"],
        ["estop", "--all"],
        ["resume"],
        ["tree", "--frobnicate"],
        ["echo", "nobody"],
        ["hz", "nobody", "--seconds", "1"],
        ["trace", "nobody"],
        ["send", "nobody", "joint=1"],
        ["record", "nobody", "-o", "run.mcap"],
        ["replay", "no-such.mcap"],
        ["drill", "so101"],
        ["matrix", "--drivers", "so999"],
        ["mesh", "status", "--mesh", "no-such.toml"],
        ["demo", "--out", "no/such/folder/demo.png"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_with_json_a_problem_is_an_object_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run([*arguments, "--json"]) == 2
    out, err = capsys.readouterr()
    result = json.loads(out)
    assert list(result) == ["error"]
    assert err == f"strands-actors: {result['error']}\n"


@pytest.mark.parametrize(
    ("arguments", "keys"),
    [
        (["list"], {"robots", "experimental", "not_installed"}),
        (["tree"], {"robots"}),
        (["mesh", "status"], {"robots"}),
        (["doctor"], {"ok", "checks"}),
    ],
    ids=lambda each: each[0] if isinstance(each, list) else "",
)
def test_json_is_one_object(cli: Command, arguments: list[str], keys: set[str]) -> None:
    assert set(cli.json(*arguments)) == keys
