"""Who may do what at a robot that others can reach, as zenoh's access rules. Whatever is not
allowed is denied below the interpreter: a flood of forged commands costs the robot next to
nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from strands_actors.supervisors.mesh.schemas import (
    BROADCAST_KEY,
    ESTOP_KEY,
    EVENT_KEY,
    RESUME_KEY,
    TELEMETRY,
    camera_topic,
    key,
)

TOPICS = (*(key("*", topic) for topic in (*TELEMETRY, camera_topic("*"))), EVENT_KEY)
ORDERS = (
    key("*", "cmd"),
    key("*", "actor/gateway"),
    key("*", "actor/gateway/stop"),
    BROADCAST_KEY,
    ESTOP_KEY,
    RESUME_KEY,
)
ANSWERS = (key("*", "response/**"), key("node", "**"))
TOKENS = (key("*", "alive"),)
GATEWAYS = (key("*", "actor/gateway/**/alive"),)

LOCAL = "unixsock-stream"
"""The user's own socket: its directory lets nobody else in."""


class Rule(NamedTuple):
    id: str
    messages: tuple[str, ...]
    flow: str  # ingress: what they send, egress: what we send
    keys: tuple[str, ...]


VIEW = (
    Rule("topics", ("put",), "egress", TOPICS),
    Rule("subscribe", ("declare_subscriber",), "ingress", TOPICS),
    Rule("tokens", ("liveliness_token",), "egress", TOKENS),
    Rule("watch", ("liveliness_query", "declare_liveliness_subscriber"), "ingress", TOKENS),
)
OPERATE = (
    Rule("orders", ("put",), "ingress", ORDERS),
    Rule("offer", ("declare_subscriber",), "egress", ORDERS),
    Rule("answers", ("put",), "egress", ANSWERS),
    Rule("ask", ("declare_subscriber",), "ingress", ANSWERS),
    Rule("gateways", ("liveliness_token",), "egress", GATEWAYS),
    Rule("find", ("liveliness_query", "declare_liveliness_subscriber"), "ingress", GATEWAYS),
)
EVERYTHING = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)


def access_control(viewers: Sequence[str], operators: Sequence[str]) -> dict[str, Any]:
    """By common name of the certificate."""
    rules = [
        {
            "id": rule.id,
            "messages": list(rule.messages),
            "flows": [rule.flow],
            "permission": "allow",
            "key_exprs": list(rule.keys),
        }
        for rule in (*VIEW, *OPERATE)
    ]
    rules.append(
        {
            "id": "local",
            "messages": list(EVERYTHING),
            "flows": ["ingress", "egress"],
            "permission": "allow",
            "key_exprs": ["**"],
        }
    )
    subjects: list[dict[str, Any]] = [{"id": "local", "link_protocols": [LOCAL]}]
    policies = [{"rules": ["local"], "subjects": ["local"]}]
    for role, names, granted in (
        ("viewers", viewers, VIEW),
        ("operators", operators, (*VIEW, *OPERATE)),
    ):
        if names:
            subjects.append({"id": role, "cert_common_names": list(names)})
            policies.append({"rules": [rule.id for rule in granted], "subjects": [role]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }
