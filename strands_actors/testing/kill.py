"""Measure the kill cells of one robot from the command line. A kill cell breaks one process of the moving robot.

``python -m strands_actors.testing.kill --robot so101 --repeats 20`` runs every cell, prints median and worst, and
ends with code 1 if the robot was not brought to a safe state, or later than the published bound.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys

import msgspec

from .faults import Cell, Faults, Victims
from .matrix import measure


def main() -> int:
    """Measure the cells that the command line names, and print each row as JSON. Return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="so101")
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--victim", action="append", help=f"{', '.join(Victims)}, or another role of its tree")
    parser.add_argument("--fault", choices=list(Faults), action="append")
    options = parser.parse_args()
    # A shell makes background jobs ignore SIGINT. The children would inherit that, so restore the default.
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def is_chosen(cell: Cell) -> bool:
        return (
            not cell.why_not
            and (not options.victim or cell.victim in options.victim)
            and cell.fault in (options.fault or list(Faults))
        )

    every_safe = True
    for row in measure(options.robot, options.repeats, only=is_chosen):
        every_safe = every_safe and row.safe
        print(json.dumps({**msgspec.structs.asdict(row), "safe": row.safe}), flush=True)
    return 0 if every_safe else 1


if __name__ == "__main__":
    sys.exit(main())
