"""Convert an encoded message to text: the name of its class, and the name and value of each field."""

from __future__ import annotations

from typing import Any

import msgspec

from strands_actors.kernel.frames import Down
from strands_actors.kernel.messages import Message, Refused
from strands_actors.supervisors.gate import messages as of_the_gate
from strands_actors.supervisors.root import messages as of_the_root
from strands_actors.supervisors.standby import messages as of_the_standby
from strands_actors.supervisors.wire import messages as of_the_wire
from strands_actors.supervisors.wire import watchdog

LONGEST = 400


def _kinds() -> dict[str, type[Message]]:
    kinds: dict[str, type[Message]] = {"Down": Down, "Refused": Refused}
    for module in (of_the_gate, of_the_root, of_the_standby, of_the_wire, watchdog):
        for name, value in vars(module).items():
            if isinstance(value, type) and issubclass(value, Message) and value is not Message:
                kinds[name] = value
    return kinds


KINDS = _kinds()


def in_words(body: bytes) -> str:
    """Return an encoded message as text, cut after ``LONGEST`` characters."""
    text = _show(msgspec.msgpack.decode(body))
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


def _show(value: Any) -> str:
    if isinstance(value, list) and value and isinstance(value[0], str) and value[0] in KINDS:
        fields = KINDS[value[0]].__struct_fields__
        return f"{value[0]}({', '.join(f'{name}={_show(v)}' for name, v in zip(fields, value[1:], strict=False))})"
    if isinstance(value, list):
        return f"[{', '.join(_show(v) for v in value)}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_show(v)}' for key, v in value.items())}}}"
    return repr(value)
