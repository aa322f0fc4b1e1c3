"""Run the vendor's unmodified client against a twin: ``body_client.py FLEET_PATH FLEET_ID WHAT``.

It runs where hello-robot-stretch-body is installed, and prints its results as one JSON object.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
import time
from typing import Any

PATIENCE_S = 20.0
"""Far longer than any step takes on a free machine."""

os.environ["HELLO_FLEET_PATH"], os.environ["HELLO_FLEET_ID"] = sys.argv[1:3]


def lift() -> dict[str, Any]:
    import stretch_body.lift

    joint = stretch_body.lift.Lift()
    started = joint.startup(threaded=False)
    joint.pull_status()
    seen = {"started": started, "from": joint.status["pos"], "homed": bool(joint.motor.status["pos_calibrated"])}
    joint.motor.disable_sync_mode()
    joint.push_command()
    joint.move_to(0.53)
    joint.push_command()
    _until(joint, lambda: abs(joint.status["pos"] - 0.53) < 2e-3)
    seen |= {"to": joint.status["pos"], "mode": joint.motor.status["mode"], "board": joint.motor.board_info}
    joint.stop()
    return seen


def arm() -> dict[str, Any]:
    import stretch_body.arm

    joint = stretch_body.arm.Arm()
    started = joint.startup(threaded=False)
    joint.pull_status()
    joint.motor.disable_sync_mode()
    joint.push_command()
    joint.move_by(0.02)
    joint.push_command()
    _until(joint, lambda: abs(joint.status["pos"] - 0.12) < 2e-3)
    seen = {"started": started, "to": joint.status["pos"]}
    joint.stop()
    return seen


def home_arm() -> dict[str, Any]:
    import stretch_body.arm

    joint = stretch_body.arm.Arm()
    started = joint.startup(threaded=False)
    joint.motor.disable_sync_mode()
    joint.push_command()
    joint.pull_status()
    seen = {"started": started, "homed": [bool(joint.motor.status["pos_calibrated"])], "from": joint.status["pos"]}
    joint.move_to(0.3)
    joint.push_command()
    time.sleep(0.5)
    joint.pull_status()
    seen |= {"without_homing": joint.status["pos"], "contacts": [joint.motor.status["guarded_event"]]}
    joint.home()
    joint.pull_status()
    seen["homed"].append(bool(joint.motor.status["pos_calibrated"]))
    seen["contacts"].append(joint.motor.status["guarded_event"])
    seen["to"] = joint.status["pos"]
    joint.stop()
    return seen


def stepper() -> dict[str, Any]:
    import stretch_body.stepper
    from stretch_body.robot_params import RobotParams

    usb = RobotParams.get_params()[1]["lift"]["usb_name"]
    board = stretch_body.stepper.Stepper(usb, name="hello-motor-lift")
    started = board.startup()
    board.read_gains_from_flash()
    board.pull_status()
    board.pull_status_aux()
    flash = dict(board.gains_flash)
    board.enable_hold()
    board.push_command()
    board.pull_status()
    waits = bool(board.status["waiting_on_sync"])
    board.disable_sync_mode()
    board.enable_hold()
    board.push_command()
    board.pull_status()
    seen = {
        "started": started,
        "mode": board.status["mode"],
        "waited_for_sync": waits,
        "watchdog_in_flash": flash["enable_vel_watchdog"],
        "pKp_d": flash["pKp_d"],
        "voltage": board.status["voltage"],
    }
    board.stop()
    return seen


def pimu() -> dict[str, Any]:
    import stretch_body.pimu

    board = stretch_body.pimu.Pimu()
    started = board.startup()
    board.pull_status()
    before = board.status["runstop_event"]
    board.runstop_event_trigger()
    board.push_command()
    board.pull_status()
    during = board.status["runstop_event"]
    board.runstop_event_reset()
    board.push_command()
    board.pull_status()
    seen = {
        "started": started,
        "runstop": [before, during, board.status["runstop_event"]],
        "voltage": board.status["voltage"],
        "current": board.status["current"],
        "az": board.status["imu"]["az"],
        "protocol": board.board_info["protocol_version"],
    }
    board.stop()
    return seen


def base() -> dict[str, Any]:
    import stretch_body.base

    wheels = stretch_body.base.Base()
    started = wheels.startup(threaded=False)
    for wheel in (wheels.left_wheel, wheels.right_wheel):
        wheel.disable_sync_mode()
    wheels.push_command()
    fastest = 0.0
    until_s = time.monotonic() + 2.0
    while time.monotonic() < until_s:
        wheels.set_velocity(0.1, 0.0)
        wheels.push_command()
        wheels.pull_status()
        fastest = max(fastest, wheels.status["x_vel"])
        time.sleep(0.05)
    deadline_s = time.monotonic() + 3.0  # without commands the firmware stops it
    while time.monotonic() < deadline_s:
        wheels.pull_status()
        time.sleep(0.05)
    seen = {"started": started, "x": wheels.status["x"], "fastest": fastest, "left_alone": wheels.status["x_vel"]}
    wheels.stop()
    return seen


def wacc() -> dict[str, Any]:
    import stretch_body.wacc

    board = stretch_body.wacc.Wacc()
    started = board.startup()
    board.pull_status()
    seen = {"started": started, "az": board.status["az"]}
    board.stop()
    return seen


def head() -> dict[str, Any]:
    import stretch_body.head

    chain = stretch_body.head.Head()
    started = chain.startup()
    chain.move_to("head_pan", -0.4)
    _until(chain, lambda: abs(chain.status["head_pan"]["pos"] + 0.4) < 0.02)
    seen = {"started": started, "head_pan": chain.status["head_pan"]["pos"]}
    chain.stop()
    return seen


def robot() -> dict[str, Any]:
    import stretch_body.robot

    whole = stretch_body.robot.Robot()
    started = whole.startup()
    homed = whole.is_homed()
    whole.lift.move_to(0.52)
    whole.arm.move_to(0.12)
    whole.push_command()
    until_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < until_s and not (
        abs(whole.status["lift"]["pos"] - 0.52) < 2e-3 and abs(whole.status["arm"]["pos"] - 0.12) < 2e-3
    ):
        time.sleep(0.05)
    seen = {
        "started": bool(started),
        "homed": bool(homed),
        "lift": whole.status["lift"]["pos"],
        "arm": whole.status["arm"]["pos"],
        "wrist_yaw": whole.status["end_of_arm"]["wrist_yaw"]["pos"],
        "voltage": whole.status["pimu"]["voltage"],
    }
    whole.stop()
    return seen


def home_robot() -> dict[str, Any]:
    import stretch_body.robot

    whole = stretch_body.robot.Robot()
    started = whole.startup()
    homed = [bool(whole.is_homed())]
    whole.home()
    homed.append(bool(whole.is_homed()))
    wrist = whole.status["end_of_arm"]
    # A thread of the client reads the servos. On a busy machine its newest values may be old.
    until_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < until_s and abs(wrist["stretch_gripper"]["pos_pct"]) > 1.0:
        time.sleep(0.05)
    seen = {
        "started": bool(started),
        "homed": homed,
        "lift": whole.status["lift"]["pos"],
        "arm": whole.status["arm"]["pos"],
        "wrist_yaw": wrist["wrist_yaw"]["pos"],
        "stretch_gripper": wrist["stretch_gripper"]["pos_pct"],
    }
    whole.stop()
    return seen


def _until(device: Any, there: Any, within_s: float = PATIENCE_S) -> None:
    deadline_s = time.monotonic() + within_s
    while time.monotonic() < deadline_s:
        device.pull_status()
        if there():
            return
        time.sleep(0.02)


WHAT = {each.__name__: each for each in (lift, arm, home_arm, stepper, pimu, base, wacc, head, robot, home_robot)}

if __name__ == "__main__":
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        found = WHAT[sys.argv[3]]()
    print(json.dumps({**found, "said": said.getvalue()[-2000:]}, default=str), flush=True)
    os._exit(0)
