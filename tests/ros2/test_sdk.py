"""zenoh-ros2-sdk, a library of another project, on the graph of a twin."""

from __future__ import annotations

import json
import subprocess
import sys
import time

from .conftest import World


def test_the_sdk_lists_the_graph_and_stops_the_arm(world: World) -> None:
    before_ns = time.monotonic_ns()
    port = world.endpoint.rpartition(":")[2]
    done = subprocess.run(
        [sys.executable, "-m", "tests.ros2.sdk_client", port, "/lab/so101"],
        capture_output=True,
        text=True,
        timeout=60.0,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["success"] and "gripper confirmed" in found["message"]
    assert found["topics"]["/lab/so101/joint_states"] == ["sensor_msgs/msg/JointState"]
    assert found["services"]["/lab/so101/stop"] == ["std_srvs/srv/Trigger"]
    assert world.twin.log.first_safe(before_ns) is not None
