"""In a process that may open few files, connect reports the problem and starts nothing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

import pytest

SCRIPT = """
import contextlib, json, os, resource, sys
from strands_actors import Robot
arm = Robot("so101", mode="real", transport="twin")
allowed = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
problems = [arm.connect_eagerly() for _ in range(2)]
resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))
children = []
for task in os.listdir("/proc/self/task"):
    with contextlib.suppress(FileNotFoundError):  # a thread that has ended since
        children += open(f"/proc/self/task/{task}/children").read().split()
then = arm.connect_eagerly()
moved = arm.send_action({"shoulder_pan": 3.0})["status"]
arm.cleanup()
print(json.dumps({"problems": problems, "children": children, "then": then, "moved": moved}))
"""


def result_with(allowed: int) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(allowed)],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
    )
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("allowed", [12, 16, 20, 24, 28, 32, 36, 44])
def test_too_few_descriptors_are_reported_and_nothing_is_started(allowed: int) -> None:
    answer = result_with(allowed)
    for problem in answer["problems"]:
        assert problem.startswith(f"connect: too few open files are allowed: {allowed}, ")
        assert "ulimit -n" in problem
    assert answer["children"] == []
    assert (answer["then"], answer["moved"]) == (None, "success")


def test_the_number_of_files_that_connect_asks_for_is_enough() -> None:
    answer = result_with(64)
    assert answer["problems"] == [None, None]
    assert len(answer["children"]) == 2, "the twin and the root"
    assert (answer["then"], answer["moved"]) == (None, "success")
