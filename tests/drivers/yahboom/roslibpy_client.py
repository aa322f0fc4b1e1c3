"""Run the unmodified roslibpy against a rosbridge: ``python -m tests.drivers.yahboom.roslibpy_client HOST
PORT``. It prints its results as JSON. It needs a separate process, since twisted's reactor cannot be started
twice."""

from __future__ import annotations

import json
import os
import sys
import time
from typing import Any

import roslibpy  # type: ignore[import-untyped]

DRIVE = {"linear": {"x": 0.4, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
ZERO = {"linear": {"x": 0, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}
HOME = {"joint1": 90, "joint2": 120, "joint3": 0, "joint4": 0, "joint5": 90, "joint6": 180, "time": 500}


def main(host: str, port: int) -> dict[str, Any]:
    ros = roslibpy.Ros(host, port)
    ros.run(10)
    odometry: list[dict[str, Any]] = []
    scans: list[dict[str, Any]] = []
    roslibpy.Topic(ros, "/odom_raw", "nav_msgs/Odometry").subscribe(odometry.append)
    roslibpy.Topic(ros, "/scan0", "sensor_msgs/LaserScan", throttle_rate=500).subscribe(scans.append)
    clock = roslibpy.Service(ros, "/rosapi/get_time", "rosapi/GetTime")
    seen: dict[str, Any] = {
        "topics": ros.get_topics(),
        "type": ros.get_topic_type("/cmd_vel"),
        "time": dict(clock.call(roslibpy.ServiceRequest(), timeout=5)),
    }
    refused: list[str] = []
    roslibpy.Service(ros, "/no_such_service", "x/Y").call(
        roslibpy.ServiceRequest(),
        lambda answer: refused.append("answered"),
        lambda error: refused.append(str(error)),
    )
    drive = roslibpy.Topic(ros, "/cmd_vel", "geometry_msgs/Twist")
    arm = roslibpy.Topic(ros, "/arm6_joints", "arm_msgs/ArmJoints")
    drive.advertise()
    arm.advertise()
    arm.publish(roslibpy.Message(HOME))
    for _ in range(10):
        drive.publish(roslibpy.Message(DRIVE))
        time.sleep(0.1)
    moved = odometry[-1]
    drive.publish(roslibpy.Message(ZERO))
    time.sleep(0.5)
    stood = odometry[-1]
    for _ in range(2):
        drive.publish(roslibpy.Message(DRIVE))
        time.sleep(0.1)
    time.sleep(0.6)  # without a zero, which the base's firmware has to supply
    seen |= {
        "refused": refused,
        "odometry": len(odometry),
        "scans": len(scans),
        "moved": moved["twist"]["twist"]["linear"]["x"],
        "stood": stood["twist"]["twist"]["linear"]["x"],
        "at": stood["pose"]["pose"]["position"]["x"],
        "zeroed": odometry[-1]["twist"]["twist"]["linear"]["x"],
    }
    return seen


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1], int(sys.argv[2]))), flush=True)
    os._exit(0)  # the reactor's thread outlives the last statement
