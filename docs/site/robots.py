"""Write the page of each robot, and the page that lists them.

Every figure comes from the tables by which the robot is driven (``facts``), so a page agrees with the driver.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from strands_actors.contract.driver import Driver, Reason
from strands_actors.drivers import list_driver_coverage
from strands_actors.kernel.messages import sentence_case

from . import facts, reports
from .build import ROOT
from .sections import level_sections, matrix_section, names, options_section, table
from .twins import twin_section

FOLDER = "robot"
INDEX = f"{FOLDER}/index.md"
PICTURES = "pictures"
THUMBNAIL_PIXELS = 120
REPORTS = f"../{reports.PLACE}"


def place_of(robot: str) -> str:
    """Return the place of a robot's page in the site."""
    return f"{FOLDER}/{robot}.md"


def pages() -> dict[str, str]:
    """Return the pages of all robots and the page that lists them, by their place in the site."""
    return {INDEX: index_page()} | {place_of(robot): robot_page(robot) for robot in facts.robots()}


def navigation() -> list[object]:
    """Return the part of the navigation with the robots: the list, each robot, and the wires."""
    wires: dict[str, None] = {
        page: None for robot in facts.robots() if (page := facts.wire(robot).page).startswith("robots/")
    }
    return [INDEX, *({robot: place_of(robot)} for robot in facts.robots()), {"Wires": list(wires)}]


# -- the list


def index_page() -> str:
    """Return the page that lists all robots."""
    rows = [
        (
            _thumbnail(robot),
            f"[`{robot}`]({robot}.md)",
            facts.product(robot),
            facts.wire(robot).text,
            str(len(facts.levels(robot)[0].driver.axes)),
            f"`{facts.levels(robot)[0].driver.fallbacks[Reason.STOP]}`",
            f"{facts.levels(robot)[0].driver.bound_s * 1e3:g} ms",
        )
        for robot in facts.robots()
    ]
    others = [(name, drivers) for name, drivers in list_driver_coverage().items() if name not in facts.robots()]
    by_lerobot = ", ".join(f"`{name}`" for name, drivers in others if drivers)
    known = ", ".join(f"`{name}`" for name, drivers in others if not drivers)
    return "\n".join(
        (
            "# Robots",
            "",
            f"These {len(rows)} robots have a driver, a twin (a simulated robot that speaks the robot's protocol) "
            f"and a page. `strands-actors list` prints their names. {_seen()}",
            "",
            *table(("", "robot", "product", "wire", "axes", "`stop()` leads to", "bound"), rows),
            "",
            "The **bound** is the longest time from the end of a process to the first frame of the safe state "
            "([glossary](../glossary.md)).",
            "",
            "## Driven by LeRobot's class",
            "",
            "This package runs LeRobot's own class of these robots, if LeRobot is installed "
            f"([LeRobot](../lerobot.md)): {by_lerobot}.",
            "",
            "## Known by name",
            "",
            "These robots have no driver. Each can be simulated from a model file, after "
            f"`register_robot(name, model_xml=...)`: {known}.",
            "",
        )
    )


def _seen() -> str:
    seen = sorted({sent.report.robot for sent in reports.reports()})
    if not seen:
        return f"No driver has been [seen to move a real robot]({REPORTS}) yet."
    return f"These were [seen on a real robot]({REPORTS}): {names(seen)}."


# -- a robot


def robot_page(robot: str) -> str:
    """Return the page of one robot."""
    usual, *others = facts.levels(robot)
    lines = [
        f"# {facts.product(robot)}",
        "",
        *_picture(robot),
        *_summary(robot, usual.driver),
        "",
        *_start(robot, [level.name for level in others]),
        *level_sections(usual.driver, "##"),
    ]
    for level in others:
        lines += [
            f'## With level="{level.name}"',
            "",
            f'`Robot("{robot}", mode="real", port=..., level="{level.name}")` uses another driver for this robot.',
            *([f"Call `{level.driver.BEFORE_MOTION}()` before it moves."] if level.driver.BEFORE_MOTION else []),
            "",
            *level_sections(level.driver, "###"),
        ]
    lines += [*options_section(robot), *twin_section(robot), *matrix_section(robot)]
    lines += reports.section(robot, reports.reports(), REPORTS)
    return "\n".join(lines)


def _picture(robot: str) -> Iterator[str]:
    if (ROOT / "docs" / PICTURES / f"{robot}.png").is_file():
        yield f"![{facts.product(robot)}, simulated](../{PICTURES}/{robot}.png)"
        yield ""


def _thumbnail(robot: str) -> str:
    """Return the small picture of a robot, for a table."""
    source = f"../{PICTURES}/{robot}.png"
    return f'<img src="{source}" width="{THUMBNAIL_PIXELS}" alt="{facts.product(robot)}">'


def _summary(robot: str, driver: Driver) -> Iterator[str]:
    wire, cls = facts.wire(robot), facts.driver_class(robot)
    rows = [("name", f'`Robot("{robot}")`')]
    if others := facts.aliases(robot):
        rows.append(("other names", ", ".join(f"`{name}`" for name in others)))
    rows.append(("wire", f"{wire.text}: [{_page_title(wire.page)}](../{wire.page})"))
    rows.append(("`port`", _port(cls)))
    rows.append(("seen on a real robot", reports.summary(robot, reports.reports(), REPORTS)))
    if clients := facts.clients_of(robot):
        rows.append(
            ("clients that drive its twin unchanged", "<br>".join(_client(robot, each) for each in clients))
        )
    rows.append(("unit of its values", driver.unit))
    rows.append(("bound", f"{driver.bound_s * 1e3:g} ms from the end of a process to the first safe frame"))
    for about, text in (
        ("policies", cls.ROLLOUTS),
        ("policies by name", cls.TASKS),
        ("simulation", cls.SIMULATION),
    ):
        if text:
            rows.append((about, sentence_case(text)))
    if cls.BEFORE_MOTION:
        rows.append(("before it moves", f"Call `{cls.BEFORE_MOTION}()`"))
    rows += [(f"experimental: {way}", sentence_case(text)) for way, text in cls.EXPERIMENTAL.items()]
    yield from table(("", ""), rows)


def _page_title(page: str) -> str:
    return (ROOT / "docs" / page).read_text().partition("\n")[0].removeprefix("# ")


def _port(cls: type[Driver]) -> str:
    kind = (
        "a serial port, such as `/dev/ttyACM0`"
        if cls.PORT_KIND == "serial"
        else f"an address, such as `{cls.PORT_LIKE}`"
    )
    return f"{kind}; may be left out" if cls.PORT_OPTIONAL else kind


def _client(robot: str, client: facts.Client) -> str:
    version = f" {client.version}" if client.version else ""
    tested = ""
    if robot not in client.robots:
        tested = f", on the twin of {names(client.robots)}, which has the same driver"
    return f"`{client.name}`{version} (`{client.test}`{tested})"


def _start(robot: str, levels: Sequence[str]) -> Iterator[str]:
    yield from (
        "## Start its twin",
        "",
        "The real driver connects to a simulated robot, over the robot's own protocol:",
        "",
        "```python",
        "from strands_actors import Robot",
        "",
        f'with Robot("{robot}", mode="real", transport="twin") as robot:',
        "    print(robot.get_observation())",
        '    print(robot.stop()["status"])',
        "```",
        "",
    )
    for level in levels:
        yield f'`Robot("{robot}", mode="real", transport="twin", level="{level}")` starts it with the other level.'
    yield f"In a terminal, `strands-actors twin {robot} --port-file /tmp/{robot}` runs only the twin."
    yield ""
