"""Access rules for the process of a named policy. The process can reach the gate of its robot and nothing else.

The wire process listens for policies on a separate socket. It accepts only a peer that knows a secret. The root
sends the secret to the policy process that it has started, over their private link. So each peer on this socket is
that policy, whatever name it gives, and only that policy gets the answers. Zenoh checks this before Python receives
a byte.
"""

from __future__ import annotations

from typing import Any

from strands_actors.kernel.node import PREFIX
from strands_actors.supervisors import addresses

WRITER = "a policy process"
"""Its name at the gate. There is one policy process at a time: before the root starts the next, it ends
the last one and has the gate end its lease."""


def node_name(robot: str, pid: int) -> str:
    return f"{robot}.policy.{pid}"


def settings(robot: str) -> dict[str, Any]:
    """Return the settings of the wire's zenoh session to which policies connect."""
    gate, answers, tokens = addresses.of(robot).gate, f"{PREFIX}/node/{robot}.policy.$*", f"{PREFIX}/**/alive"
    rules = [
        _rule("ask", "put", "ingress", gate),
        _rule("offer", "declare_subscriber", "egress", gate),
        _rule("be there", "liveliness_token", "egress", f"{gate}/alive"),
        _rule("look", "declare_liveliness_subscriber", "ingress", tokens),
        _rule("look back", "liveliness_query", "ingress", tokens),
        _rule("answer", "put", "egress", answers),
        _rule("listen", "declare_subscriber", "ingress", answers),
    ]
    return {
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": rules,
            "subjects": [{"id": "policy"}],
            "policies": [{"rules": [rule["id"] for rule in rules], "subjects": ["policy"]}],
        }
    }


def _rule(name: str, message: str, flow: str, key: str) -> dict[str, Any]:
    return {"id": name, "messages": [message], "flows": [flow], "permission": "allow", "key_exprs": [key]}
