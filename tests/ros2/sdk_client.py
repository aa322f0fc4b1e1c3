"""Look at a graph and stop an arm with zenoh-ros2-sdk: ``python -m tests.ros2.sdk_client PORT PREFIX``.

It prints a JSON object: the names of topics and services with their types, and the response of ``PREFIX/stop``. Of
this project it uses nothing. The definition of Trigger is given, because the SDK would load it from the network.
"""

from __future__ import annotations

import json
import sys
import time

from zenoh_ros2_sdk import ROS2ServiceClient, get_service_names_and_types, get_topic_names_and_types

TRIGGER_HASH = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
"""The SDK computes the same, but looks for further definitions in the network before."""


def main(port: int, prefix: str) -> None:
    client = ROS2ServiceClient(
        f"{prefix}/stop",
        "std_srvs/srv/Trigger",
        "uint8 structure_needs_at_least_one_member",
        "bool success\nstring message",
        domain_id=0,
        router_port=port,
        type_hash=TRIGGER_HASH,
    )
    time.sleep(1.0)  # A list that is requested at once after the start is empty.
    response = client.call(structure_needs_at_least_one_member=0)
    found = {
        "topics": dict(get_topic_names_and_types(domain_id=0, router_port=port)),
        "services": dict(get_service_names_and_types(domain_id=0, router_port=port)),
        "success": bool(response.success),
        "message": response.message,
    }
    print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
