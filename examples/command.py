"""Move a robot with plain zenoh, no import of strands-actors: python examples/command.py ROBOT
JOINT=VALUE ...

The robot runs on this host, as this user; its own script has released it: arm.release().
"""

import json
import secrets
import sys
import time

import zenoh
from telemetry import endpoints

ME = f"example-{secrets.token_hex(4)}"
PROOF = secrets.token_hex(16)  # ours alone: the same name with another proof is another sender


def ask(session: zenoh.Session, robot: str, **command: object) -> dict:
    """Ask a robot for something; its result."""
    question = {"sender_id": ME, "turn_id": secrets.token_hex(8), "proof": PROOF, "command": command}
    print(json.dumps(question))
    for reply in session.get(f"strands/{robot}/cmd/{ME}", payload=json.dumps(question), timeout=2.0):
        if reply.ok is not None:
            answer = json.loads(reply.ok.payload.to_string())
            print(json.dumps(answer))
            if answer["type"] == "error":
                raise SystemExit(answer["error"])
            return answer["result"]
    raise SystemExit(f"{robot} does not answer")


def wait_for(session: zenoh.Session, robot: str) -> None:
    """Until it is seen: links are made while this program runs on."""
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
        ahead_ns = clock["robot_ns"] - time.monotonic_ns()  # of the robot's clock; never too much

        def dated(seconds: float) -> dict:
            """Return until when something may be done, by the robot's clock."""
            deadline_ns = time.monotonic_ns() + ahead_ns + int(seconds * 1e9)
            return {"clock": clock["clock"], "deadline_ns": deadline_ns}

        had = ask(session, robot, action="acquire", **dated(0.5))
        lease = {"lease": had["lease"], "epoch": had["epoch"]}
        ask(session, robot, action="move", targets=targets, **lease, **dated(1.0))
        time.sleep(0.7)  # it is on its way. the lease ends after a second without "beat"
        ask(session, robot, action="release", lease=lease["lease"])  # it holds, and others may move it


if __name__ == "__main__":
    main(sys.argv[1], {joint: float(value) for joint, _, value in (pair.partition("=") for pair in sys.argv[2:])})
