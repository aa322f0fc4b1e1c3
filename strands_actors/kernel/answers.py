"""Check the kind of an answer: the message that was expected, or a refusal."""

from __future__ import annotations

from typing import TypeVar

from .messages import Message, Refused
from .refusals import Code

Answer = TypeVar("Answer", bound=Message)


def read_answer(answer: Message | None, kind: type[Answer], verb: str = "") -> Answer | Refused:
    """Return the answer if it is of that kind or a refusal. Else return a refusal: a missing answer, and
    an answer of another kind, are no success (SAF-023)."""
    if isinstance(answer, kind | Refused):
        return answer
    return Refused(Code.NO_ANSWER, "no answer", verb=verb)


__all__ = ["read_answer"]
