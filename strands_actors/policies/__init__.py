"""Policies (programs that turn observations into actions): the base class, and the policies that have a name.

    from strands_actors.policies import MockPolicy, Policy, create_policy, register_policy

``robot.run_policy(policy)`` runs a policy object in the process of the script.
``robot.start_task(policy_provider=name)`` runs a policy by name, in a separate process.
"""

from __future__ import annotations

from .base import Policy
from .factory import create_policy
from .mock import MockPolicy
from .registry import list_providers, register_policy

__all__ = ["MockPolicy", "Policy", "create_policy", "list_providers", "register_policy"]
