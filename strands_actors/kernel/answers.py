"""Check the type of an answer: the expected message, or a refusal."""

from __future__ import annotations

from typing import TypeVar

from . import refusals
from .messages import Message, Refused

Answer = TypeVar("Answer", bound=Message)


def read_answer(answer: Message | None, answer_type: type[Answer], verb: str = "") -> Answer | Refused:
    """Return the answer if it has the expected type or is a refusal.

    Otherwise return a refusal: a missing answer, or one of another type, is no success (SAF-023).

    Args:
        answer: The answer as received.
        answer_type: The expected type.
        verb: The verb that the refusal names.
    """
    if isinstance(answer, answer_type | Refused):
        return answer
    return refusals.no_answer(verb)


__all__ = ["read_answer"]
