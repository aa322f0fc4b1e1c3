"""The reports of drills on real robots (``docs/reports``), and the page that is made from them.

``python -m docs.site.reports`` checks every report and writes ``docs/seen-on-real-robots.md``.
"""

from __future__ import annotations

import functools
import re
import sys
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from strands_actors.surfaces.drill.report import FORM, BadReport, Report, parse, require_real

from .build import ROOT
from .sections import table

FOLDER = ROOT / "docs" / "reports"
PLACE = "seen-on-real-robots.md"
PAGE = ROOT / "docs" / PLACE
WIDTH = 100
NAME = re.compile(r"(?P<robot>[a-z0-9_]+)-(?P<date>\d{4}-\d\d-\d\d)(-\d+)?")

HEAD = f"""# Seen on real robots

This page lists the stop drills that people have made on real robots and sent in. All other figures
of these pages were measured on twins, which are simulated robots. A real robot may behave in
another way, so please send a report of your robot. A failed drill is as useful as a passed one.

## Send a report

1. Read [before you use a robot](safety.md#before-you-use-a-robot). Lay the robot down, and hold its
   emergency stop in your hand.
2. Run the [drill](safety-evidence.md#the-stop-drill) with `--report`:
   `strands-actors drill so101 --port /dev/ttyACM0 --report report.json`
3. Read `report.json`. The drill also prints it.
4. Open an issue of the project with the form "{FORM}", and paste the report.

A report has these fields: the robot's name in this package, the driver and its wire, the kind of
the connection, the firmware that the robot reports, the version of this package, the day, and for
each step its safe state and its times. Of the computer it has the operating system, the
architecture, the number of processors and the version of Python. It has no name of a person, user
or computer, no address, port, path, serial number or option, and no text of an error. Write what
the robot did into the form.

## Add a report that was sent in

1. Save the report, unchanged, as `docs/reports/ROBOT-DATE.json`, such as
   `docs/reports/so101-2027-01-31.json`. For a second report of the same day add `-2`.
2. Run `python -m docs.site.reports`. It checks all reports and writes this page.

The command refuses a file that is damaged, that is no report of this package, or that has a step or
a time that no drill has. It also refuses a drill that was made on a twin, or on a program of the
same computer, which may be a twin.

## Reports

"""
EMPTY = """**There is no report yet.** As far as the project knows, no driver of this package has ever moved a
real robot.
"""


class Sent(NamedTuple):
    """A report that was sent in, and the name of its file."""

    name: str
    report: Report


def read(folder: Path) -> list[Sent]:
    """Return the reports of a folder by robot, the newest first.

    Raises:
        BadReport: A file is no report of a real robot. The text begins with the name of the file.
    """
    found = [Sent(path.name, _read(path)) for path in sorted(folder.glob("*.json"), reverse=True)]
    return sorted(found, key=lambda sent: sent.report.robot)


def _read(path: Path) -> Report:
    try:
        report = parse(path.read_bytes())
        require_real(report)
    except BadReport as reason:
        raise BadReport(f"{path.name}: {reason}") from None
    name = NAME.fullmatch(path.stem)
    if name is None or (name["robot"], name["date"]) != (report.robot, report.date):
        raise BadReport(f"{path.name}: a report of {report.robot} of this day is {report.robot}-{report.date}.json")
    return report


@functools.cache
def reports() -> tuple[Sent, ...]:
    """Return the reports of ``docs/reports``."""
    return tuple(read(FOLDER))


def of_robot(robot: str, sent: Sequence[Sent]) -> list[Sent]:
    return [each for each in sent if each.report.robot == robot]


# -- texts


def page(sent: Sequence[Sent]) -> str:
    """Return the page of all reports."""
    robots = dict.fromkeys(each.report.robot for each in sent)
    if not robots:
        return HEAD + EMPTY
    passed = sum(each.report.passed for each in sent)
    lines = [f"Reports: {len(sent)}, of {len(robots)} robots. Drills that passed every step: {passed}.", ""]
    for robot in robots:
        lines += [f"### {robot}", "", *_drills(of_robot(robot, sent))]
    return HEAD + "\n".join(lines).rstrip() + "\n"


def summary(robot: str, sent: Sequence[Sent], to_page: str) -> str:
    """Return one line about the drills on a robot, for the table at the top of its page.

    Args:
        robot: The robot's name.
        sent: All reports.
        to_page: The link to the page of all reports.
    """
    mine = of_robot(robot, sent)
    if not mine:
        return f"not yet ([send a report]({to_page}#send-a-report))"
    passed = sum(each.report.passed for each in mine)
    newest = max(each.report.date for each in mine)
    return (
        f"[{len(mine)} drill{'s' if len(mine) > 1 else ''}]({to_page}#{robot}), {passed} passed, last on {newest}"
    )


def section(robot: str, sent: Sequence[Sent], to_page: str) -> Iterator[str]:
    """Yield the section of a robot's page about the real robot."""
    yield from ("## What has been seen on a real one", "")
    mine = of_robot(robot, sent)
    if mine:
        yield from _drills(mine)
    else:
        yield "Nothing yet. All figures of this page come from the driver's tables and from the robot's twin."
        yield from (f"[Send a report]({to_page}#send-a-report) of your robot.", "")


def _drills(sent: Sequence[Sent]) -> Iterator[str]:
    for each in sent:
        report = each.report
        failed = [step.step for step in report.steps if not step.passed]
        verdict = f"**failed: {', '.join(failed)}**" if failed else "passed"
        firmware = f"firmware {', '.join(report.firmware)}" if report.firmware else "firmware not reported"
        computer = report.computer
        facts = (
            f"{report.date}: {verdict}. Package {report.package_version}, {firmware}, by {report.connection}, on "
            f"{computer.system} {computer.architecture} with {computer.cpus} processors and Python "
            f"{computer.python} (`{each.name}`)."
        )
        yield from textwrap.wrap(facts, WIDTH, break_long_words=False, break_on_hyphens=False)
        yield ""
        yield from table(
            ("step", "safe state", "confirmed after", "bound of the first frame", ""),
            [
                (
                    step.step,
                    f"`{step.safe_state}`",
                    "not confirmed" if step.confirmed_ms is None else f"{step.confirmed_ms:.1f} ms",
                    f"{step.bound_ms:.0f} ms",
                    "ok" if step.passed else "**failed**",
                )
                for step in report.steps
            ],
        )
        yield ""


def main() -> int:
    try:
        sent = reports()
    except BadReport as reason:
        print(f"docs/reports: {reason}", file=sys.stderr)
        return 1
    PAGE.write_text(page(sent))
    print(f"{PAGE.relative_to(ROOT)}: {len(sent)} reports")
    return 0


if __name__ == "__main__":
    sys.exit(main())
