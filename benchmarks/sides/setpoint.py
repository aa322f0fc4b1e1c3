"""``setpoint WHO LENGTH ROBOT PORT LOG``: the time from the call to the first byte that the twin reads.

WHO is ours, strands, sdk or process. All sides use the same twin over the same wire. Each has its usual units.
"""

from __future__ import annotations

import json
import multiprocessing
import sys
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from .wire import Log, delays_us, percentile

COUNT = {"short": 60, "long": 300}
JOINT = {"so101": "shoulder_pan", "ur5e": "elbow_joint"}
STEP = {"so101": 2.0, "ur5e": 0.01}
"""In degrees and radians. The steps pass every step gate of a stream at 30 and 125 Hz."""

ALLOWANCE_US = 1000.0
"""Our p99 may be so much later than that of the reference, which runs in the caller's thread."""

CYCLE_S = {"so101": 1 / 30, "ur5e": 1 / 125}
"""Period in which an otherwise idle process reads the robot (Feetech), or sends its last setpoint again (UR)."""

Send = Callable[[int], int]
Cycle = Callable[[], object]


def wave(robot: str, number: int) -> float:
    """Return the offset of a setpoint. Successive ones differ."""
    return STEP[robot] * (1 + number % 3)


def ours(robot: str, port: str) -> tuple[Send, Callable[[], object]]:
    from benchmarks.stage import at_home
    from strands_actors import Robot

    at_home()
    arm = Robot(robot, mode="real", port=port)
    return _verbs(arm, robot)


def strands(robot: str, port: str) -> tuple[Send, Callable[[], object]]:
    from strands_robots import Robot

    arm = Robot(robot, mode="real", driver="strands", port=port)
    return _verbs(arm, robot)


def _verbs(arm: Any, robot: str) -> tuple[Send, Callable[[], object]]:
    problem = arm.connect_eagerly()
    if problem is not None:
        raise RuntimeError(problem)
    joint = JOINT[robot]
    observed = arm.get_observation()
    base = observed.get(joint, observed.get(f"{joint}.pos", 0.0))

    def send(number: int) -> int:
        action = {joint: base + wave(robot, number)}
        began_ns = time.monotonic_ns()
        answer = arm.send_action(action)
        if answer["status"] != "success":
            raise RuntimeError(str(answer))
        return began_ns

    return send, arm.cleanup


def sdk(robot: str, port: str) -> tuple[Send, Callable[[], object]]:
    send, _, close = _sdk(robot, port)
    return send, close


def process(robot: str, port: str) -> tuple[Send, Callable[[], object]]:
    """Return a side with the SDK in a separate process, which keeps the robot's cycle, and a pipe to it.

    This is the least cost of a process that outlives the caller. It has no actors, gates, leases and
    deadlines.
    """
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()
    child = context.Process(target=_keep, args=(there, robot, port), daemon=True)
    child.start()
    here.recv()

    def send(number: int) -> int:
        began_ns = time.monotonic_ns()
        here.send(number)
        return began_ns

    return send, child.kill


def _keep(pipe: Connection, robot: str, port: str) -> None:
    send, cycle, _ = _sdk(robot, port)
    pipe.send("ready")
    due_s = time.monotonic()
    while True:
        if pipe.poll(max(0.0, due_s - time.monotonic())):
            send(pipe.recv())
        else:
            cycle()
            due_s += CYCLE_S[robot]


def _sdk(robot: str, port: str) -> tuple[Send, Cycle, Callable[[], object]]:
    return _feetech_sdk(port) if robot == "so101" else _ur_sdk(port.partition(":")[0])


def _feetech_sdk(port: str) -> tuple[Send, Cycle, Callable[[], object]]:
    from scservo_sdk import GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

    line, packets = PortHandler(port), PacketHandler(0)
    line.openPort()
    line.setBaudRate(1_000_000)
    for motor in range(1, 7):
        packets.write1ByteTxRx(line, motor, 40, 1)
    reader = GroupSyncRead(line, packets, 56, 8)
    for motor in range(1, 7):
        reader.addParam(motor)

    def send(number: int) -> int:
        count = 2048 + round(11 * wave("so101", number))
        began_ns = time.monotonic_ns()
        group = GroupSyncWrite(line, packets, 42, 2)
        for motor in range(1, 7):
            group.addParam(motor, [count & 255, count >> 8])
        group.txPacket()
        return began_ns

    return send, reader.txRxPacket, line.closePort


def ur_arm(host: str) -> tuple[Any, list[float], Cycle]:
    """Return the SDK's control of an arm, a target (first the present position), and a function that sends
    the target."""
    from rtde_control import RTDEControlInterface
    from rtde_receive import RTDEReceiveInterface

    receive, control = RTDEReceiveInterface(host), RTDEControlInterface(host)
    target = list(receive.getActualQ())
    return control, target, lambda: control.servoJ(target, 0.5, 0.5, CYCLE_S["ur5e"], 0.1, 300)


def _ur_sdk(host: str) -> tuple[Send, Cycle, Callable[[], object]]:
    control, target, again = ur_arm(host)
    base = list(target)

    def send(number: int) -> int:
        target[2] = base[2] + wave("ur5e", number)
        began_ns = time.monotonic_ns()
        again()
        return began_ns

    def close() -> None:
        control.servoStop()
        control.stopScript()

    return send, again, close


def main(who: str, length: str, robot: str, port: str, log: str) -> None:
    send, close = {"ours": ours, "strands": strands, "sdk": sdk, "process": process}[who](robot, port)
    calls_us: list[float] = []

    def timed(number: int) -> int:
        began_ns = send(number)
        calls_us.append((time.monotonic_ns() - began_ns) / 1e3)
        return began_ns

    wire = Log(log)
    for number in range(20):  # warm-up
        send(number)
        time.sleep(0.02)
    delays = delays_us(timed, wire, COUNT[length])
    close()
    p99 = percentile(delays, 0.99)
    figures = {
        "p50_us": percentile(delays, 0.5),
        "p99_us": p99,
        "call_p50_us": percentile(calls_us, 0.5),
        "late_us": p99 + (ALLOWANCE_US if who == "strands" else 0.0),
    }
    print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
