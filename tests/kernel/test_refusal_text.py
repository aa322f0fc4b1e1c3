"""How a refusal is shown to people."""

from __future__ import annotations

import pytest

from strands_actors.kernel.messages import Refused, sentence_case


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("wait, then try again", "Wait, then try again"),
        ("e-stop the robot", "E-stop the robot"),
        ("resume() when the robot is back", "resume() when the robot is back"),
        ("move_to() has a time", "move_to() has a time"),
        ("check the USB cable", "Check the USB cable"),
        ("", ""),
    ],
)
def test_a_sentence_begins_with_a_capital_unless_it_begins_with_code(text: str, shown: str) -> None:
    assert sentence_case(text) == shown


def test_a_refusal_is_shown_with_its_verb_reason_and_remedy() -> None:
    refusal = Refused("past_travel", "pan 400 is past 110", "stay within -110..110")
    assert refusal.text == "pan 400 is past 110. Stay within -110..110"
    assert refusal.about("move").text == "move: pan 400 is past 110. Stay within -110..110"
    assert Refused("empty", "names no joint").text == "names no joint"
