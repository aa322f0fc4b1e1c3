"""Move a robot with plain zenoh, without importing strands-actors.

python examples/command.py ROBOT JOINT=VALUE ...

The robot must run on this host and under this user. The script that started it must have called
``arm.release()``, since only the program that holds the lease (the right to command) may move a robot.

The sequence of requests is: sync (read the robot's clock), acquire (get the lease), move, release. Each
request is answered with a result or an error.
"""

import json
import secrets
import sys
import time

import zenoh
from telemetry import endpoints

ME = f"example-{secrets.token_hex(4)}"
# A secret of this program. A robot treats the same sender_id with another proof as another sender.
PROOF = secrets.token_hex(16)


def ask(session: zenoh.Session, robot: str, **command: object) -> dict:
    """Send a command to a robot and return its result. Exit with the robot's error if it refuses."""
    request = {"sender_id": ME, "turn_id": secrets.token_hex(8), "proof": PROOF, "command": command}
    print(json.dumps(request))
    for reply in session.get(f"strands/{robot}/cmd/{ME}", payload=json.dumps(request), timeout=2.0):
        if reply.ok is not None:
            response = json.loads(reply.ok.payload.to_string())
            print(json.dumps(response))
            if response["type"] == "error":
                raise SystemExit(response["error"])
            return response["result"]
    raise SystemExit(f"{robot} does not answer")


def wait_for(session: zenoh.Session, robot: str) -> None:
    """Wait up to 5 s until the robot is visible: zenoh connects in the background."""
    until = time.monotonic() + 5.0
    while not any(reply.ok for reply in session.liveliness().get(f"strands/{robot}/alive", timeout=0.5)):
        if time.monotonic() > until:
            raise SystemExit(f"{robot} is not there")
        time.sleep(0.1)


def main(robot: str, targets: dict[str, float]) -> None:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps(endpoints()))
    with zenoh.open(config) as session:
        wait_for(session, robot)
        clock = ask(session, robot, action="sync")
        # Estimate how far the robot's clock is ahead of this clock. The response took some time to arrive, so
        # the estimate is never too large, and no deadline is later than intended.
        ahead_ns = clock["robot_ns"] - time.monotonic_ns()

        def deadline_in(seconds: float) -> dict:
            """Return a deadline ``seconds`` from now, in the robot's time, for a request."""
            deadline_ns = time.monotonic_ns() + ahead_ns + int(seconds * 1e9)
            return {"clock": clock["clock"], "deadline_ns": deadline_ns}

        granted = ask(session, robot, action="acquire", **deadline_in(0.5))
        lease = {"lease": granted["lease"], "epoch": granted["epoch"]}
        ask(session, robot, action="move", targets=targets, **lease, **deadline_in(1.0))
        # The robot moves for 0.7 s. A lease ends 1 s after its holder's last request, so release the lease
        # before that.
        time.sleep(0.7)
        # After the release the robot holds its position, and other programs may acquire the lease.
        ask(session, robot, action="release", lease=lease["lease"])


if __name__ == "__main__":
    main(sys.argv[1], {joint: float(value) for joint, _, value in (pair.partition("=") for pair in sys.argv[2:])})
