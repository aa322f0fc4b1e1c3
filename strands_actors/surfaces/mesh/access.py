"""The access rules of a robot on the mesh, in zenoh's form.

Zenoh denies everything that no rule allows, in native code. So a flood of forged commands costs the robot
almost no processor time.

Zenoh does not tell a robot which peer sent a put or a query. So a command that moves the robot must be a
query on a key that ends with the sender's name. The rules allow each operator only keys with its own name. A
put can only stop the robot or read its state. Each operator receives only the answers to its own queries.
"""

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
    command_key,
    key,
)

TOPICS = (*(key("*", topic) for topic in (*TELEMETRY, camera_topic("*"))), EVENT_KEY)


def questions(name: str) -> tuple[str, ...]:
    """Return the keys on which a peer of this name may send queries: commands in JSON, and messages to
    ``gateway``, the robot's actor that checks commands."""
    return command_key("*", name), key("*", f"actor/gateway/from/{name}")


QUESTIONS = questions("*")
ORDERS = (
    key("*", "cmd"),
    key("*", "actor/gateway/stop"),
    BROADCAST_KEY,
    ESTOP_KEY,
    RESUME_KEY,
)
TOKENS = (key("*", "alive"),)
GATEWAYS = (key("*", "actor/gateway/**/alive"),)

OPEN = "tcp"
LOCAL = "unixsock-stream"
"""The protocol of this user's socket. Only this user can open its directory."""


class Rule(NamedTuple):
    """A rule that allows some messages on some keys."""

    id: str
    messages: tuple[str, ...]
    flow: str  # "ingress" is from the peer to the robot, "egress" from the robot to the peer, "" both.
    keys: tuple[str, ...]


VIEW = (
    Rule("topics", ("put",), "egress", TOPICS),
    Rule("subscribe", ("declare_subscriber",), "ingress", TOPICS),
    Rule("tokens", ("liveliness_token",), "egress", TOKENS),
    Rule("watch", ("liveliness_query", "declare_liveliness_subscriber"), "ingress", TOKENS),
)
COMMAND = (
    Rule("orders", ("put",), "ingress", ORDERS),
    Rule("offer", ("declare_subscriber",), "egress", ORDERS),
    Rule("replies", ("reply", "declare_queryable"), "egress", QUESTIONS),
)
OPERATE = (
    *COMMAND,
    Rule("gateways", ("liveliness_token",), "egress", GATEWAYS),
    Rule("find", ("liveliness_query", "declare_liveliness_subscriber"), "ingress", GATEWAYS),
)


HERE = (
    Rule("all topics", ("put",), "egress", (*TOPICS, key("*", "response/**"), key("node", "**"))),
    Rule("listen", ("declare_subscriber",), "ingress", ("**",)),
    Rule("look", ("liveliness_query", "declare_liveliness_subscriber"), "ingress", ("**",)),
    Rule("all tokens", ("liveliness_token",), "egress", (*TOKENS, *GATEWAYS)),
    *COMMAND,
    Rule("questions", ("query",), "ingress", QUESTIONS),
)
"""Rules for programs of this user. They may subscribe to everything. They do not receive the commands of
other senders, which contain leases."""


def own_prefix(name: str) -> str:
    """Return the prefix that all senders and nodes of a certificate's holder must have in their names."""
    return f"{name}."


def answers(name: str) -> tuple[Rule, ...]:
    """Return the rules that allow the queries of one operator, and the answers to this operator."""
    own = f"{own_prefix(name)}$*"
    keys = (key(own, "response/**"), key("node", f"{own}/**"))
    return (
        Rule(
            f"questions of {name}",
            ("query",),
            "ingress",
            questions(own),
        ),
        Rule(f"answers to {name}", ("put",), "egress", keys),
        Rule(f"asked by {name}", ("declare_subscriber",), "ingress", keys),
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


_Granted = tuple[str, dict[str, list[str]], Sequence[Rule]]
"""The id of a subject, the property that identifies it, and its rules."""


def access_control(
    viewers: Sequence[str] = (), operators: Sequence[str] = (), anybody: bool = False
) -> dict[str, Any]:
    """Return the access rules of a robot.

    Args:
        viewers: Common names of the certificates that may read telemetry.
        operators: Common names of the certificates that may also command.
        anybody: True also allows everything to peers without a certificate.
    """
    rules = list({rule.id: rule for rule in (*VIEW, *OPERATE, *HERE)}.values())
    granted: list[_Granted] = [(f"viewer {name}", {"cert_common_names": [name]}, VIEW) for name in viewers]
    for name in operators:
        own = answers(name)
        rules += own
        granted.append((f"operator {name}", {"cert_common_names": [name]}, (*VIEW, *OPERATE, *own)))
    granted.append(("local", {"link_protocols": [LOCAL]}, HERE))
    if anybody:
        everything = Rule("everything", EVERYTHING, "", ("**",))
        rules.append(everything)
        granted.append(("anybody", {"link_protocols": [OPEN]}, (everything,)))
    return _control(rules, granted)


def only(robot: str) -> dict[str, Any]:
    """Return the access rules of a program that communicates with one robot only. They exclude any other peer
    at the robot's address."""
    everything = Rule("everything", EVERYTHING, "", ("**",))
    return _control([everything], [(robot, {"cert_common_names": [robot]}, (everything,))])


def _control(rules: Sequence[Rule], granted: Sequence[_Granted]) -> dict[str, Any]:
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            {
                "id": rule.id,
                "messages": list(rule.messages),
                "flows": [rule.flow] if rule.flow else ["ingress", "egress"],
                "permission": "allow",
                "key_exprs": list(rule.keys),
            }
            for rule in rules
        ],
        "subjects": [{"id": name, **by} for name, by, _ in granted],
        "policies": [{"rules": [rule.id for rule in allowed], "subjects": [name]} for name, _, allowed in granted],
    }
