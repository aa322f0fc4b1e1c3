"""Draw ``docs/robots/crazyflie.svg``: height and tilt of the twin after processes were killed in flight.

``python -m tests.drivers.crazyflie.plot`` flies the twin once for each case, in half a minute.
"""

from __future__ import annotations

import os
import signal
import tempfile
import time
from pathlib import Path

import matplotlib

from tests.answers import pids

from .test_tree import drone

TARGET = Path(__file__).parents[3] / "docs" / "robots" / "crazyflie.svg"
VICTIMS = {
    "wire killed": ("wire",),
    "root killed": ("root",),
    "root and wire killed": ("root", "wire"),
    "root, wire and standby killed": ("root", "standby", "wire"),
}
BEFORE_S, AFTER_S = 0.5, 3.5
EVERY = 3
"""Use every third row of the trace. Rows are ten milliseconds apart."""

Track = list[tuple[float, float, float]]


def fly(roles: tuple[str, ...]) -> Track:
    """Return seconds since the kill, height and tilt."""
    with tempfile.TemporaryDirectory(prefix="cf-") as directory, drone(Path(directory)) as cf:
        cf.fly()
        victims = [pids(cf.robot)[role] for role in roles]
        began_ns = time.monotonic_ns()
        for pid in victims:
            os.kill(pid, signal.SIGSTOP)  # stopped first, so that no process notices another's end
        for pid in victims:
            os.kill(pid, signal.SIGKILL)
        time.sleep(AFTER_S + 0.2)
        track = cf.track(began_ns - round(BEFORE_S * 1e9))
    return [(at - BEFORE_S, z, tilt) for at, z, tilt in track if at <= BEFORE_S + AFTER_S][::EVERY]


def draw(tracks: dict[str, Track]) -> None:
    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "crazyflie"
    from matplotlib import pyplot

    figure, (height, tilt) = pyplot.subplots(2, 1, sharex=True, figsize=(7, 4.2), height_ratios=(2, 1))
    for name, track in tracks.items():
        seconds, heights, tilts = zip(*track, strict=True)
        height.plot(seconds, heights, label=name, linewidth=1.2)
        tilt.plot(seconds, tilts, linewidth=1.0)
    for axes in (height, tilt):
        axes.axvline(0.0, color="0.6", linewidth=0.8)
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    height.set_ylabel("height, m")
    height.legend(frameon=False)
    tilt.set_ylabel("tilt, degrees")
    tilt.set_xlabel("seconds after the kill")
    figure.tight_layout()
    figure.savefig(TARGET, metadata={"Date": None})


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(prefix="sa-") as run:
        os.environ["STRANDS_ACTORS_RUN"] = run
        draw({name: fly(roles) for name, roles in VICTIMS.items()})
