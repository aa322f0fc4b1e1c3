"""Policies: what they are made from, and the ones that are known by name.

from strands_actors.policies import MockPolicy, Policy, create_policy, register_policy

A policy object goes to ``robot.run_policy``, which runs it in the script's process; a name to
``robot.start_task(policy_provider=...)``, which runs it in a process of its own.
"""

from __future__ import annotations

from .base import Policy
from .factory import create_policy
from .mock import MockPolicy
from .registry import list_providers, register_policy

__all__ = ["MockPolicy", "Policy", "create_policy", "list_providers", "register_policy"]
