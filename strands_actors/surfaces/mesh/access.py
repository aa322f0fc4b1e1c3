"""Who may do what at a robot that others can reach, as zenoh's access rules. Whatever is not
allowed is denied below the interpreter: a flood of forged commands costs the robot next to
nothing.

Zenoh tells a robot nothing of who has put a sample or asks a question. So what moves a robot is asked, on
a key that ends with the name of who asks, and each operator may ask under its own name alone. What
is put can stop and read, and each operator hears the answers to its own name alone.
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


def questions(who: str) -> tuple[str, ...]:
    """Return the keys on which ``who`` asks: commands, and the gateway."""
    return command_key("*", who), key("*", f"actor/gateway/from/{who}")


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
"""The user's own socket: its directory lets nobody else in."""


class Rule(NamedTuple):
    id: str
    messages: tuple[str, ...]
    flow: str  # ingress: what they send, egress: what we send; empty: both
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
"""Programs of this user. They may listen to everything, and are sent no command that another gives: there is
a lease in it."""


def own_prefix(name: str) -> str:
    """With what senders and nodes of this certificate's holder begin."""
    return f"{name}."


def answers(name: str) -> tuple[Rule, ...]:
    """Return what one operator asks, and is answered."""
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
"""Who, by what that is known, and what for."""


def access_control(
    viewers: Sequence[str] = (), operators: Sequence[str] = (), anybody: bool = False
) -> dict[str, Any]:
    """Of a robot. By common name of the certificate. ``anybody``: who comes without one, too."""
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
    """Of who talks with one robot: whoever else is at its address is neither heard nor told
    anything."""
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
        "subjects": [{"id": who, **by} for who, by, _ in granted],
        "policies": [{"rules": [rule.id for rule in allowed], "subjects": [who]} for who, _, allowed in granted],
    }
