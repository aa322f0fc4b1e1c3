"""Which policy somebody on the mesh may have run: one that is installed on the robot's host, by its
name, and with a server at an address that the host allows.

The packages that bring policies are named to this process and not imported in it.
"""

from __future__ import annotations

from typing import Any

import trio

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.guard import allowed
from strands_actors.kernel.refusals import Code

from .schemas import Start

CHOOSE = "strands_actors.policies.registry:choose_provider"
FACTS = "strands_actors.policies.registry:robot_facts"
ALLOW_HOSTS = "STRANDS_MESH_POLICY_HOST_ALLOW"
"""Environment of the robot's host: where else a policy's server may be, separated by commas."""
OWN_HOST = frozenset({"localhost", "127.0.0.1", "::1"})


async def choose(driver: Driver, command: Start, robot: str) -> tuple[str, dict[str, Any]] | Refused:
    """Return ``module:factory`` of the policy and its options, or why not. ``robot``: the name that
    it runs by."""
    name, host = command.policy_provider, command.policy_host
    if ":" in name:  # code of the sender's choice
        why = f"policy_provider is {name[:40]!r}"
        return Refused(
            Code.BAD_POLICY, why, "on the mesh it is the name of a policy that is installed here", name[:40]
        )
    if host not in OWN_HOST | allowed(ALLOW_HOSTS):
        why = f"policy_host is {host[:40]!r}"
        return Refused(
            Code.BAD_POLICY, why, f"the robot's host allows {', '.join(sorted(OWN_HOST))}, and {ALLOW_HOSTS}"
        )

    def run() -> tuple[str, dict[str, Any]]:  # it looks through what is installed: milliseconds
        provider, options = load(CHOOSE)(name, host, command.policy_port, {})
        return provider.where, {**load(FACTS)(provider, driver, robot), **options}

    try:
        return await trio.to_thread.run_sync(run)
    except ValueError as error:
        return Refused(Code.BAD_POLICY, str(error))
