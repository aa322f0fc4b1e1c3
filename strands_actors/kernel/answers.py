"""What was answered to a question, as a type: the answer that was asked for, or a refusal."""

from __future__ import annotations

from typing import TypeVar

from .messages import Message, Refused
from .refusals import Code

Answer = TypeVar("Answer", bound=Message)


def read_answer(answer: Message | None, kind: type[Answer], verb: str = "") -> Answer | Refused:
    """Return an answer of that kind, or the refusal that came in its place. No answer, and any other
    one, is a refusal, too (SAF-023)."""
    if isinstance(answer, kind | Refused):
        return answer
    return Refused(Code.NO_ANSWER, "no answer", verb=verb)


__all__ = ["read_answer"]
