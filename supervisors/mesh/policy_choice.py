"""Decide which policy a sender on the mesh may run.

The policy must be installed on the robot's host, and the sender gives only its name. If the policy uses a server,
the server's address must be one that the host allows. This process looks up the installed policies and does not
import them.
"""

from __future__ import annotations

from typing import Any

import trio

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.guard import allowed

from . import refusals
from .schemas import Start

CHOOSE = "strands_actors.policies.registry:choose_provider"
FACTS = "strands_actors.policies.registry:robot_facts"
ALLOW_HOSTS = "STRANDS_MESH_POLICY_HOST_ALLOW"
"""Environment variable of the robot's host: further hosts of policy servers, separated by commas."""
OWN_HOST = frozenset({"localhost", "127.0.0.1", "::1"})


async def choose(driver: Driver, command: Start, robot: str) -> tuple[str, dict[str, Any]] | Refused:
    """Return ``module:factory`` of the policy and its options, or a refusal.

    Args:
        driver: Driver of the robot.
        command: The command that starts the policy.
        robot: Name of the robot.
    """
    name, host = command.policy_provider, command.policy_host
    # A name with a colon is a path to code, so the sender could choose which code runs here.
    if ":" in name:
        return refusals.policy_path(name[:40])
    if host not in OWN_HOST | allowed(ALLOW_HOSTS):
        return refusals.policy_host_not_allowed(host[:40], ", ".join(sorted(OWN_HOST)), ALLOW_HOSTS)

    # The search through the installed packages takes milliseconds, so it runs in a thread.
    def run() -> tuple[str, dict[str, Any]]:
        provider, options = load(CHOOSE)(name, host, command.policy_port, {})
        return provider.where, {**load(FACTS)(provider, driver, robot), **options}

    try:
        return await trio.to_thread.run_sync(run)
    except ValueError as error:
        return refusals.unusable_policy(error)
