"""A caller that the tests kill. It prints ``ready``, and then calls one verb of a stopped robot when a
line arrives.

Arguments: robot, port, keywords of the robot in JSON, arguments of the services in JSON, the verb
(``resume``, ``connect_eagerly``, or the name of a service), then the services that must run before it,
after a resume.
"""

from __future__ import annotations

import functools
import json
import sys
import time
from typing import Any

from strands_actors import Robot

START_S = 60.0
"""Timeout for a robot to be ready, on a busy machine."""


def succeed(call: Any, *arguments: Any) -> None:
    """Call a verb until it succeeds. On a busy machine a process may be late enough to count as frozen."""
    deadline_s = time.monotonic() + START_S
    while True:
        answer = call(*arguments)
        if answer is None or (isinstance(answer, dict) and answer["status"] == "success"):
            return
        if time.monotonic() > deadline_s:
            raise SystemExit(f"not ready: {answer}")
        time.sleep(0.05)


def main(name: str, port: str, keywords: str, arguments: str, verb: str, *before: str) -> None:
    robot = Robot(name, mode="real", port=port, **json.loads(keywords))
    given = json.loads(arguments)

    def service_call(service: str) -> Any:
        """Return a call of the service, with those of the arguments that it has."""
        has = robot.driver.SERVICES[service].arguments
        named = {key: value for key, value in given.items() if key in has}
        return functools.partial(robot.service, service, **named)

    if verb != "connect_eagerly":
        succeed(robot.connect_eagerly)
        if verb == "resume":
            succeed(robot.stop)
        for service in before:
            succeed(service_call(service))
    print(json.dumps("ready"), flush=True)
    while line := sys.stdin.readline().strip():
        call = getattr(robot, verb) if verb in ("resume", "connect_eagerly") else service_call(verb)
        answer = {"stop": robot.stop}.get(line, call)()
        print(json.dumps(answer if isinstance(answer, dict) else {"status": str(answer)}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
