"""The description of an exception that the user's code raised."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
import trio

from strands_actors.kernel.user_code import contained, describe_failure
from strands_actors.policies import create_policy


def key_error() -> None:
    raise KeyError("x")


def exits() -> None:
    raise SystemExit(3)


@pytest.mark.parametrize(
    ("call", "place"),
    [
        (key_error, r"\(test_user_code.py:\d+ in key_error\)"),
        (exits, r"in exits\)"),
        (partial(create_policy, "no such provider"), r"[^)]"),
    ],
)
def test_the_named_line_is_never_one_of_the_calling_thread(call: Callable[[], Any], place: str) -> None:
    async def fail() -> str:
        try:
            await trio.to_thread.run_sync(contained, call)
        except Exception as error:
            return describe_failure(error)
        raise AssertionError("it was expected to fail")

    text = trio.run(fail)
    assert "_threads.py" not in text
    assert re.search(place + r"\Z", text), text
