"""The documentation site: every robot has a page that agrees with its driver, and the site loads nothing."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
import yaml

from docs.site import api, diagrams, docstrings, facts, gates, markdown, offline, robots, sources
from strands_actors.contract.driver import Driver, Reason
from strands_actors.drivers import get_native_driver_class, list_native_drivers
from strands_actors.drivers.spot.driver import Spot
from tests.covered import unmeasured

from .test_imports import ROOT

BUILD_S = 300.0
"""The build takes a quarter of a minute on a machine that is free."""


def built(robot: str) -> Driver:
    driver_class = get_native_driver_class(robot)
    assert driver_class is not None
    driver: Driver = driver_class(robot, "", driver_class.resolve(robot, {}))
    return driver


def rows(page: str, heading: str, table: int = 0) -> list[list[str]]:
    """Return the cells of a table below a heading, without its titles."""
    section = re.split(r"^##+ ", page.partition(f"# {heading}\n")[2], maxsplit=1, flags=re.MULTILINE)[0]
    tables = re.findall(r"(?:^\|.*\n)+", section, re.MULTILINE)
    return [
        [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in tables[table].splitlines()[2:]
    ]


# -- pages of robots


def test_every_robot_has_a_page_with_its_joints_and_a_place_in_the_navigation() -> None:
    pages = robots.pages()
    assert set(pages) == {robots.INDEX, *map(robots.place_of, list_native_drivers())}
    shown = [place for entry in robots.navigation() if isinstance(entry, dict) for place in entry.values()]
    assert {place for place in shown if isinstance(place, str)} == set(pages) - {robots.INDEX}
    lacking = {
        robot: missing
        for robot in list_native_drivers()
        if (missing := [key for key in built(robot).axes if f"| `{key}`" not in pages[robots.place_of(robot)]])
    }
    assert lacking == {}
    assert [robot for robot in list_native_drivers() if f"[`{robot}`]({robot}.md)" not in pages[robots.INDEX]] == []
    for robot in list_native_drivers():
        page = pages[robots.place_of(robot)]
        assert "\n## What has been seen on a real one\n" in page and "(../seen-on-real-robots.md#" in page


def test_no_page_is_twice_in_the_navigation() -> None:
    _, _, navigation = (ROOT / "docs" / "site" / "mkdocs.yml").read_text().partition("\nnav:\n")
    written = [*places(yaml.safe_load(navigation)), *places(robots.navigation()), *places(api.navigation())]
    twice = {place for place in written if written.count(place) > 1}
    assert twice == {robots.INDEX, api.INDEX}, "the hook replaces these two"


def places(entries: list[Any]) -> Iterator[str]:
    """Yield the places of a navigation."""
    for entry in entries:
        if isinstance(entry, str):
            yield entry
        else:
            for value in entry.values():
                yield from places(value if isinstance(value, list) else [value])


@pytest.mark.parametrize("robot", ["so101", "unitree_g1"])
def test_a_page_agrees_with_the_table_of_the_driver(robot: str) -> None:
    driver, page = built(robot), robots.robot_page(robot)
    shown = {row[0].strip("`"): row for row in rows(page, "Joints")}
    assert list(shown) == list(driver.axes)
    for axis in driver.table:
        _, _, number, unit, low, high, speed = shown[axis.key]
        assert (int(number), unit) == (axis.id, axis.unit)
        assert (float(low), float(high), float(speed)) == pytest.approx((axis.low, axis.high, axis.speed), rel=1e-5)
    after = {state.strip("`"): reasons for state, _, reasons in rows(page, "Safe states")}
    for reason in Reason:
        assert [state for state, reasons in after.items() if f"(`{reason}`)" in reasons] == [
            driver.fallbacks[reason]
        ]
    assert f"{driver.bound_s * 1e3:g} ms from the end of a process" in page
    assert driver.firmware_watchdog[1:] in page
    assert {cell for row in rows(page, "Options") for cell in re.findall(r"`(\w+)`", row[0])} == {
        *driver.OPTIONS,
        *driver.SPELLINGS,
    }
    assert [row[0].strip("`") for row in rows(page, "Verbs and services")] == [
        verb.name for verb in driver.TOOL_VERBS
    ]


def test_a_joint_that_turns_without_end_has_no_limit_on_its_page() -> None:
    joints = {row[0]: row[4:6] for row in rows(robots.robot_page("kinova_gen3"), "Joints")}
    assert joints["`joint_1`"] == ["no limit", "no limit"]
    assert joints["`joint_2`"] == ["-2.24", "2.24"]


def test_a_page_has_the_worst_time_of_each_victim_in_the_kill_matrix() -> None:
    measured = json.loads((ROOT / "docs" / "kill-matrix.json").read_text())["so101"]["rows"]
    table = rows(robots.robot_page("so101"), "Kill matrix")
    shown = {victim: (fault, worst, bound) for victim, _, fault, worst, bound in table}
    assert set(shown) == {row["victim"] for row in measured if "why_not" not in row}
    for victim, (fault, worst, bound) in shown.items():
        (row,) = [each for each in measured if (each["victim"], each["fault"]) == (victim, fault)]
        assert (worst, bound) == (f"{row['worst_ms']:.1f} ms", f"{row['bound_ms']:.0f} ms")
    assert "[`so101`](so101.md#kill-matrix)" in robots.robot_page("so100"), "it was measured on a robot like it"


def test_a_robot_that_walks_has_both_levels_on_its_page() -> None:
    page = robots.robot_page("unitree_go2")
    assert page.count(" Joints\n") == 2 and '## With level="sport"' in page
    walking = rows(page.partition('level="sport"\n')[2], "Joints")
    assert [row[0] for row in walking] == [f"`{key}` (a speed)" for key in ("vx", "vy", "wz")]


def test_a_gate_is_described_by_its_docstring_or_by_its_codes() -> None:
    arm, spot = facts.levels("robotiq_2f85")[0].driver, facts.levels("spot")[0].driver
    described = {gate.name: gate for gate in map(gates.gate_facts, arm.gates)}
    assert described["activated"].about == "Refuse if the gripper is not activated."
    assert [str(code) for code in described["stale"].codes] == ["stale"]
    assert isinstance(spot, Spot)
    names = [gates.gate_facts(gate).name for gate in spot.gates]
    assert "stale" in names, "a gate that wraps another one is described as the other one"


def test_every_client_is_run_by_its_test_at_the_version_that_is_shown() -> None:
    robots_of_clients = {robot for client in facts.clients() for robot in client.robots}
    assert robots_of_clients <= set(list_native_drivers())
    assert [client.test for client in facts.clients() if not (ROOT / client.test).is_file()] == []
    pinned = {client.name: client.version for client in facts.clients()}
    assert pinned["xarm-python-sdk"] == "1.18.4" and pinned["hello-robot-stretch-body"] == "0.7.31"
    assert [client.name for client in facts.clients_of("fr3")] == ["pylibfranka"]
    assert "on the twin of `so101`" in robots.robot_page("so100")


# -- text


def test_the_readme_names_the_clients_of_each_robot() -> None:
    shown = {robot: facts.wire(robot).tested_with for robot in list_native_drivers()}
    assert shown.pop("reachy_mini") == "the vendor's daemon", "tests/peers"
    of_row: dict[str, set[str]] = {}
    for robot, text in shown.items():
        of_row.setdefault(text, set()).update(client.name for client in facts.clients_of(robot))
    assert of_row.pop("–") == set()
    assert of_row == {text: set(text.split(", ")) for text in of_row}


def test_links_lead_to_the_places_of_the_site() -> None:
    code = "```\n[d](docs/safety.md)\n```\n"
    text = "[a](docs/safety.md) [b](CONTRIBUTING.md#add-a-wire) [c](examples/policy.py)\n"
    moved = "[a](safety.md) [b](contributing.md#add-a-wire) [c](source/examples/policy.py.md)\n"
    assert sources.relinked(text + code, "index.md") == moved + code
    back = "[a](../../README.md#robots) [b](../motion.md#move_to) [c](https://example.org)"
    moved = "[a](../index.md#robots) [b](../motion.md#move_to) [c](https://example.org)"
    assert sources.relinked(back, "robots/ur.md") == moved


def test_anchors_are_those_of_github() -> None:
    assert markdown.slug("Break things: `Victims` × `Faults`", "-") == "break-things-victims--faults"
    assert markdown.slug("The TOML file", "-") == "the-toml-file"


DOCSTRING = """\
Do it.

Example:
    do(1)

    do(2)

Args:
    it: A number.

``a``    one
         more
``b``    two
"""

AS_MARKDOWN = """\
Do it.

Example:
    ```python
    do(1)

    do(2)
    ```

Args:
    it: A number.

* ``a``: one
    more
* ``b``: two
"""


def test_an_example_in_a_docstring_is_code_and_aligned_names_are_a_list() -> None:
    assert docstrings.readable(DOCSTRING) == AS_MARKDOWN


def test_the_comment_of_a_field_is_its_docstring() -> None:
    lines = [
        "class Times:",
        "    a: str = '#'  # the first",
        "    # It is the",
        "    # second.",
        "    b: int = 2",
        "    c: int",
    ]
    assert [docstrings.comment_of(lines, index) for index in (1, 4, 5)] == ["the first", "It is the second.", ""]
    assert docstrings.comment_of(["d = 1  # noqa: E501"], 0) == ""


def test_every_diagram_was_drawn_after_its_last_change() -> None:
    pages = {path.relative_to(ROOT / "docs").as_posix(): path.read_text() for path in diagrams.pages()}
    assert "architecture.md" in pages
    drawn = {
        diagrams.drawing_of(place, number, source)
        for place, text in pages.items()
        for number, source in enumerate(diagrams.MERMAID.findall(text), 1)
    }
    there = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs" / diagrams.FOLDER).iterdir()}
    assert drawn == there
    with pytest.raises(diagrams.Missing, match=r"mesh.md: diagram 1 has no picture. Run: .*docs.site.diagrams"):
        diagrams.drawing_of("mesh.md", 1, "flowchart LR\n  a --> b\n")


def test_what_a_page_loads_from_a_network_is_found(tmp_path: Path) -> None:
    page = """<a href="https://a.org">a</a><script src="https://b.org/b.js"></script>
        <link rel="next" href="//c.org"><img alt='d' src=//d.org/d.png><img src='e.png'>"""
    assert offline.loaded(page) == ["https://b.org/b.js", "//d.org/d.png"]
    (tmp_path / "f.css").write_text('@import "https://f.org/f.css"; a {background: url(g.png)}')
    assert offline.foreign_resources(tmp_path) == ["f.css: https://f.org/f.css"]


# -- the site


class Html(HTMLParser):
    """The links and anchors of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("id", "name") and value:
                self.anchors.add(value)
            elif name in ("href", "src") and value and tag != "base":
                self.links.append(unquote(value))


def broken_links(site: Path) -> Iterator[str]:
    pages = {path: Html(path.read_text()) for path in site.rglob("*.html")}
    for path, page in pages.items():
        for link in page.links:
            target, _, anchor = link.partition("#")
            if re.match(r"[a-z]+:", link):
                continue
            file = (path.parent / target.partition("?")[0]).resolve() if target else path
            if not file.is_file() or (anchor and file in pages and anchor not in pages[file].anchors):
                yield f"{path.relative_to(site)}: {link}"


def test_the_site_is_built_without_a_warning_and_works_from_a_folder(tmp_path: Path) -> None:
    command = ["nice", "-n", "19", sys.executable, "-m", "docs", str(tmp_path / "site")]
    done = subprocess.run(
        command, cwd=ROOT, env=unmeasured(), capture_output=True, text=True, timeout=BUILD_S, check=False
    )
    assert done.returncode == 0, done.stderr
    site = tmp_path / "site"
    for robot in list_native_drivers():
        page = (site / "robot" / f"{robot}.html").read_text()
        assert [key for key in built(robot).axes if f"<code>{key}</code>" not in page] == [], robot
    assert list(broken_links(site)) == []
    assert not (site / "404.html").exists()
    assert offline.foreign_resources(site) == []
    assert (site / "search" / "search_index.js").read_text().startswith("var __index = {")
    assert (site / "api" / "strands_actors.contract.html").read_text().count("doc-class") > 20
