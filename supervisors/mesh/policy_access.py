"""What the process of a named policy reaches on the mesh: the gate of its robot, which answers it.
Nothing else.

The wire listens for it on a socket of its own, which lets in who knows a secret: the root tells it
to the policy process that it starts, over its link. So who comes in there is known to be that
policy, whatever it says of itself, and nobody else hears what it is answered. The rules are
zenoh's, applied before Python sees a byte.
"""

from __future__ import annotations

from typing import Any

from strands_actors.kernel.node import PREFIX
from strands_actors.supervisors import addresses

WRITER = "a policy process"
"""What the gate knows it as. There is one at a time: the root ends the last one, and has the gate
end its lease, before it starts the next."""


def node_name(robot: str, pid: int) -> str:
    return f"{robot}.policy.{pid}"


def settings(robot: str) -> dict[str, Any]:
    """Of the wire's session for policies."""
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
