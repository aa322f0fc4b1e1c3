"""``drill --report``: write the report of a drill, show it, and say where to send it."""

from __future__ import annotations

from pathlib import Path

from strands_actors.caller.processes.plan import Plan
from strands_actors.surfaces.drill import report as reports
from strands_actors.surfaces.drill.run import Outcome

from .errors import Problem

SEND = f"""\
To send this report, read it, and open an issue of the project with the form "{reports.FORM}".
It names no person, host, address, path or serial number.
"""
NOT_REAL = """\
This report shows nothing about a real robot, so do not send it: {reason}.
"""


def check(path: Path, planned: Plan) -> None:
    """Raise ``Problem`` before the drill if its report could not be written afterwards."""
    if not reports.is_reportable(planned.robot, planned.driver_class):
        raise Problem(
            f"drill: the driver of {planned.robot} does not belong to this package, so the project cannot use a "
            "report. Leave out --report, and send the output of the drill to the authors of the driver"
        )
    if path.exists():
        raise Problem(f"drill: {path} exists already. Give --report another name")
    if not path.absolute().parent.is_dir():
        raise Problem(f"drill: there is no folder {path.parent} for the report. Make it first")


def write(outcome: Outcome, path: Path | None) -> str:
    """Write the report of a drill, if there is a path. Return the problem; empty if there is none."""
    if path is None or outcome.report is None:
        return ""
    try:
        reports.write(outcome.report, path)
    except OSError as error:
        return f"drill: the report cannot be written to {path}: {error.strerror}. The drill itself is done"
    return ""


def show(outcome: Outcome, path: Path) -> None:
    """Print the content of the report, and where to send it."""
    if outcome.report is None:
        return
    print(f"\nReport in {path}:\n\n{reports.encode(outcome.report).decode()}")
    try:
        reports.require_real(outcome.report)
    except reports.BadReport as reason:
        print(NOT_REAL.format(reason=reason), end="")
    else:
        print(SEND, end="")
