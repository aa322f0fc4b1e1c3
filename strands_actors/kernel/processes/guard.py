"""Find commands that need the approval of an operator (guarded commands).

``Driver.GUARDED`` names guarded verbs and keys of an action. An environment variable allows some of them
without asking. A process that can ask a person (``agents/approval.py``) asks for the rest. Other processes
refuse them.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping

from strands_actors.kernel import refusals
from strands_actors.kernel.messages import Refused

ALLOW = "STRANDS_ACTORS_ALLOW"
"""Environment variable with the guarded names that are allowed without asking, separated by commas."""


ALLOW_TOPICS = "STRANDS_ROS2_COMMAND_ALLOW"
"""Environment variable with the ROS topics that may be published on without asking, separated by commas."""


def allowed(variable: str = ALLOW) -> frozenset[str]:
    return frozenset(name for part in os.environ.get(variable, "").split(",") if (name := part.strip()))


def unapproved(
    guarded: Collection[str], names: Iterable[str], topics: Mapping[str, str] | None = None
) -> tuple[str, ...]:
    """Return the names that need approval, sorted.

    Args:
        guarded: The guarded names of a robot.
        names: Verbs, or keys of an action. A key counts the same with and without ``.pos``.
        topics: ROS topic by name, for names that are published on ROS. The environment may allow a whole topic.
    """
    plain = (str(name).removesuffix(".pos") for name in names)
    by_topic, of = allowed(ALLOW_TOPICS), topics or {}
    not_allowed = frozenset(guarded).intersection(plain) - allowed()
    return tuple(sorted(name for name in not_allowed if of.get(name) not in by_topic))


def not_approved(names: Iterable[str], cause: str, can_ask: bool = True) -> Refused:
    """Return the refusal of a command, because an operator has not approved some names in it.

    Args:
        names: The names without approval (verbs, or keys of an action).
        cause: Why there is no approval, for people.
        can_ask: True if the program could pass ``approve=``. On the mesh that is not possible.
    """
    return refusals.not_approved(", ".join(names), cause, ALLOW, can_ask)
