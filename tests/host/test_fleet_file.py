"""The file of a host: all faults at once, each with its line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from strands_actors.surfaces.host.fleet import METRICS, BadFleet
from strands_actors.surfaces.host.fleet_file import WEB_PORT, read_fleet
from strands_actors.surfaces.host.toml_lines import lines_of

GOOD = """
[host]
metrics = false

[robot.left]
type = "so101"
port = "/dev/serial/by-id/left"
on_exit = "limp"
guarded = ["move_to"]
cameras.wrist = {index_or_path = 0, fps = 30, width = 640, height = 480}

[robot.twin]
type = "koch"
transport = "twin"
mesh = {listen = "tcp/127.0.0.1:7447", insecure = true}
approve = "os.path:exists"

[robot.simulated]
type = "so101"
position = [0.1, 0.0, 0.0]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "fleet.toml"
    path.write_text(text)
    return path


def faults(folder: Path, text: str) -> dict[int, str]:
    with pytest.raises(BadFleet) as caught:
        read_fleet(written(folder, text))
    assert len({fault.line for fault in caught.value.faults}) == len(caught.value.faults), str(caught.value)
    return dict(caught.value.faults)


def test_a_good_file_has_a_plan_for_each_robot(tmp_path: Path) -> None:
    fleet = read_fleet(written(tmp_path, GOOD))
    assert fleet.services == {}
    plans = {name: spec.plan() for name, spec in fleet.robots.items()}
    assert {name: plan.tool_name for name, plan in plans.items()} == {name: name for name in plans}
    assert plans["left"].port == "/dev/serial/by-id/left"
    assert [camera.name for camera in plans["left"].cameras] == ["wrist"]
    assert plans["left"].hosted is not None
    assert plans["left"].hosted["guarded"] == ["move_to"]
    assert plans["twin"].transport == "twin"
    assert plans["twin"].mesh.listens == ["tcp/127.0.0.1:7447"]
    assert plans["simulated"].transport == "sim"


def test_all_faults_are_told_at_once_with_their_lines(tmp_path: Path) -> None:
    text = """\
[hots]
[host]
metrics = 3
[robot.left]
type = "so101"
prot = "/dev/ttyACM0"
lifetime = -3.0
port = "/dev/ttyACM0"
[robot.right]
type = "so101"
port = "/dev/ttyACM0"
[robot.other]
type = "so101"
id = "right"
port = "/dev/ttyACM1"
[robot.no-file]
type = "so100"
transport = "twin"
mesh = "missing.toml"
arm = 3
[robot.unknown]
type = "nothing"
[robot.model]
type = "so101"
urdf_path = "missing.xml"
[robot.away]
type = "so101"
at = "tls/there:7447"
[robot."bad name"]
type = "so101"
[robot.typeless]
port = "/dev/ttyACM3"
"""
    found = faults(tmp_path, text)
    expected = {
        1: "unknown key 'hots' ('host'?)",
        3: "metrics is 3",
        6: "takes no 'prot' ('prot' -> 'port'?)",
        7: "lifetime is -3.0",
        11: "left has the same port (/dev/ttyACM0)",
        14: "two robots have the name right",
        19: "missing.toml cannot be read",
        20: "arm is 3",
        22: "'nothing' is not known",
        25: "missing.xml",
        28: "at cannot stand in this file",
        29: "the name 'bad name' cannot be used",
        31: "type is missing",
    }
    assert found.keys() == expected.keys()
    for line, part in expected.items():
        assert part in found[line], found[line]


@pytest.mark.parametrize(
    ("text", "line", "part"),
    [
        ("[robot.a]\ntype = so101\n", 2, "Invalid value"),
        ("[robot.a]\ntype = 'so101'\n[robot.a]\ntype = 'so101'\n", 3, "Cannot declare"),
        ("", 0, "it names no robot"),
        ("robot = 3\n", 1, "Give a table"),
        ("[robot.a]\ntype = 'so101'\nadapter = 5\n", 3, "adapter is 5"),
        ("[robot.a]\ntype = 'so101'\ntransport = 'twin'\nguarded = ['fly']\n", 4, "fly"),
        ("[robot.a]\ntype = 'so101'\napprove = 'no.such:thing'\n", 3, "can be imported"),
        ("[robot.a]\ntype = 'so101'\nmesh = {listen = 'tcp/0.0.0.0:7447'}\n", 3, "TLS"),
    ],
)
def test_a_fault_has_its_line(tmp_path: Path, text: str, line: int, part: str) -> None:
    found = faults(tmp_path, text)
    assert part.lower() in found[line].lower(), found


def test_a_file_that_is_no_text_or_not_there_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    with pytest.raises(BadFleet, match="cannot be read"):
        read_fleet(path)
    path.write_bytes(b"# one\n# \xff\n")
    with pytest.raises(BadFleet, match=r":2: this is not UTF-8"):
        read_fleet(path)


def services(folder: Path, text: str) -> Mapping[str, Mapping[str, Any]]:
    return read_fleet(written(folder, f"[host]\n{text}\n[robot.a]\ntype = 'so101'\n")).services


def test_metrics_are_served_unless_the_file_says_no(tmp_path: Path) -> None:
    host, _, port = METRICS.partition(":")
    assert services(tmp_path, "") == {"metrics": {"host": host, "port": int(port), "traces": ""}}
    assert services(tmp_path, "metrics = false") == {}


def test_traces_go_to_the_collector_of_the_file(tmp_path: Path) -> None:
    url = "http://127.0.0.1:4318/v1/traces"
    assert services(tmp_path, f'traces = "{url}"')["metrics"]["traces"] == url
    for line in ('traces = "there"', "traces = 3", f'metrics = false\ntraces = "{url}"'):
        assert "traces: " in str(faults(tmp_path, f"[host]\n{line}\n[robot.a]\ntype = 'so101'\n"))


def test_the_console_and_the_bridge_of_ros_are_served_if_the_file_says_so(tmp_path: Path) -> None:
    assert services(tmp_path, "metrics = false\nweb = true") == {"web": {"port": WEB_PORT}}
    assert services(tmp_path, "metrics = false\nweb = 0")["web"] == {"port": 0}
    assert services(tmp_path, "ros2 = true")["ros2"]["options"] == [0, "", "tcp/localhost:7447", False, False]
    table = 'ros2 = {domain = 7, namespace = "/lab", humble = true}'
    assert services(tmp_path, table)["ros2"]["options"] == [7, "/lab", "tcp/localhost:7447", True, False]


@pytest.mark.parametrize(
    "line",
    ['web = "yes"', "web = -1", "web = 65535", "web = 1.5", "ros2 = 3", "ros2 = {domain = 233}", "ros2 = {dom = 1}",
     'ros2 = {namespace = "lab"}', 'ros2 = {router = "udp/x"}', "ros2 = {humble = 1}"],
)  # fmt: skip
def test_a_wrong_option_of_a_service_is_named(tmp_path: Path, line: str) -> None:
    found = faults(tmp_path, f"[host]\n{line}\n[robot.a]\ntype = 'so101'\n")
    assert found.keys() == {2} and found[2].startswith(line.partition(" ")[0]) and "Give" in found[2]


KEYS = st.sampled_from(["a", "b", "c.d", '"x y"', "'z'"])
VALUES = st.sampled_from(
    ["1", '"text"', "[1,\n 2]", '"""two\nlines"""', "{e = 1, f = [2]}", "'''[not a table]\n'''"]
)


@settings(max_examples=30)
@given(st.dictionaries(KEYS, st.dictionaries(KEYS, VALUES, max_size=4), max_size=4))
def test_each_key_has_the_line_of_its_statement(tables: dict[str, dict[str, str]]) -> None:
    lines: list[str] = []
    expected = []
    for table, keys in tables.items():
        lines.append(f"[{table}]")
        for key, value in keys.items():
            expected.append(((table, key), len(lines) + 1))
            lines += f"{key} = {value}  # comment".split("\n")
    found = lines_of("\n".join(lines))

    def path(*keys: str) -> tuple[str, ...]:
        return tuple(part.strip("\"'") for key in keys for part in key.split("."))

    assert {keys: found[path(*keys)] for keys, _ in expected} == dict(expected)


def test_the_example_has_no_faults() -> None:
    fleet = read_fleet(Path(__file__).parents[2] / "examples" / "host" / "fleet.toml")
    assert list(fleet.robots) == ["left", "right"]
