"""``setpoint PROGRAM LENGTH ROBOT PORT LOG``: measure the time from the call that sends a setpoint until the
simulated robot reads the first byte of it.

PROGRAM is the program that is measured: ``ours``, ``strands`` (strands-robots), ``sdk`` (the vendor's SDK) or
``process`` (the SDK in another process). LENGTH is ``short`` or ``long``. All programs connect to the simulated
robot at PORT, and each commands in its units. LOG is the file of the frames that the simulated robot has read.
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
    """Return the offset of setpoint ``number`` from the first position. Successive setpoints have different
    offsets.
    """
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
    """Run the SDK in a separate process, which also reads or commands the robot once per cycle. Setpoints reach it
    through a pipe.

    This is the smallest cost of a process that continues after the script. It has no actors and no checks.
    """
    context = multiprocessing.get_context("fork")
    parent_end, child_end = context.Pipe()
    child = context.Process(target=_keep, args=(child_end, robot, port), daemon=True)
    child.start()
    parent_end.recv()

    def send(number: int) -> int:
        began_ns = time.monotonic_ns()
        parent_end.send(number)
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
    """Return the SDK's control object of an arm, a list with its target, and a function that sends this target.

    The target is the present position at first.
    """
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


def main(program: str, length: str, robot: str, port: str, log: str) -> None:
    send, close = {"ours": ours, "strands": strands, "sdk": sdk, "process": process}[program](robot, port)
    calls_us: list[float] = []

    def timed(number: int) -> int:
        began_ns = send(number)
        calls_us.append((time.monotonic_ns() - began_ns) / 1e3)
        return began_ns

    wire = Log(log)
    # These setpoints are a warm-up and are not measured.
    for number in range(20):
        send(number)
        time.sleep(0.02)
    delays = delays_us(timed, wire, COUNT[length])
    close()
    p99 = percentile(delays, 0.99)
    figures = {
        "p50_us": percentile(delays, 0.5),
        "p99_us": p99,
        "call_p50_us": percentile(calls_us, 0.5),
        "late_us": p99 + (ALLOWANCE_US if program == "strands" else 0.0),
    }
    print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
