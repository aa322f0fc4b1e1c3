"""Three robots move for half an hour. No process grows, and every resume works.

``python -m tests soak`` runs only this test, ``python -m tests long`` runs it with others.
``SOAK_MINUTES`` sets the duration (30), ``SOAK_ROBOTS`` the names of the robots.
"""

from __future__ import annotations

import faulthandler
import json
import os
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path

import pytest

from .growth import Sample, descendants, growth_of, sample

MINUTES = float(os.environ.get("SOAK_MINUTES", "30"))
ROBOTS = os.environ.get("SOAK_ROBOTS", "so101 xarm7 ur5e").split()
SETTLES = 1 / 3
"""Share of the time, at the beginning, in which a process may grow: caches fill, and each page of a ring
is touched for the first time."""
SAMPLES = 90
"""Number of readings in the whole time."""
END_S = 60.0
POLICY_S = 8.0
"""A little more than the 5 s for which the process of a policy lives."""


@pytest.mark.long
@pytest.mark.real_time
def test_nothing_grows_and_every_resume_works(tmp_path: Path) -> None:
    out, errors = tmp_path / "verbs.jsonl", tmp_path / "errors.txt"
    seconds = MINUTES * 60
    # Pytest would end this test after 300 s. Each wait below has a deadline.
    faulthandler.cancel_dump_traceback_later()
    with out.open("w") as verbs, errors.open("w") as problems:
        mover = subprocess.Popen(
            [sys.executable, "-m", "tests.soak.mover", str(seconds), *ROBOTS],
            stdout=verbs,
            stderr=problems,
            stdin=subprocess.DEVNULL,
        )
        try:
            samples, names = _watch(mover, seconds)
            left = _until_ended(mover)
        finally:
            mover.kill()
            mover.wait()
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    failed = [line for line in lines if not line["ok"]]
    assert mover.returncode == 0, errors.read_text()[-3000:]
    assert not [line for line in failed if line["verb"] in ("resume", "stop", "cleanup")], failed
    assert not failed, failed
    for robot in ROBOTS:
        counted = [line["verb"] for line in lines if line["robot"] == robot]
        assert counted.count("resume") >= seconds / 40, f"{robot}: {counted}"
    assert not left, f"processes are left: {left}"
    grown = {
        f"{names[pid]} ({pid})": found
        for pid, rows in samples.items()
        if (found := growth_of([each for each in rows if each.t_s >= seconds * SETTLES]))
    }
    assert not grown, grown


def _watch(mover: subprocess.Popen[bytes], seconds: float) -> tuple[dict[int, list[Sample]], dict[int, str]]:
    """Read the program and all its processes until shortly before its end.

    Returns:
        The readings of those processes that lived for the whole time in which growth counts, and the
        names of all.
    """
    began_s = time.monotonic()
    samples, names = defaultdict[int, list[Sample]](list), dict[int, str]()
    pause_s = max(0.5, seconds / SAMPLES)
    while (passed_s := time.monotonic() - began_s) < seconds and mover.poll() is None:
        for pid, name in descendants(mover.pid).items():
            row = sample(pid, passed_s)
            if row is not None:
                samples[pid].append(row)
                names[pid] = name
        time.sleep(pause_s)
    begins_s, ends_s = seconds * SETTLES, seconds - 2 * pause_s
    lasted = {
        pid: rows for pid, rows in samples.items() if rows[0].t_s <= begins_s and rows[-1].t_s >= ends_s - POLICY_S
    }
    for pid in lasted:
        print(f"{names[pid]:20} {_told(lasted[pid], begins_s)}")
    return lasted, names


def _told(rows: list[Sample], begins_s: float) -> str:
    """Return a line for people: the readings at the beginning, when growth begins to count, and at the
    end."""
    counted = next((each for each in rows if each.t_s >= begins_s), rows[-1])
    return "  ".join(
        f"{each.t_s:6.0f} s: {each.files} files, {each.threads} threads, {each.memory_kb} kB"
        for each in (rows[0], counted, rows[-1])
    )


def _until_ended(mover: subprocess.Popen[bytes]) -> dict[int, str]:
    """Wait for the end of the program, and return those of its processes that outlive it."""
    known = descendants(mover.pid)
    mover.wait(timeout=END_S)
    deadline_s = time.monotonic() + END_S
    while True:
        left = {pid: name for pid, name in known.items() if pid != mover.pid and sample(pid, 0.0) is not None}
        if not left or time.monotonic() > deadline_s:
            return left
        time.sleep(0.1)
