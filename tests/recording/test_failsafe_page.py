"""The page of the failsafe machine shows the machine's own table, all of it, and is up to date."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from strands_actors.supervisors.gate.failsafe import TRANSITIONS, Action, Event, Mode, State, step
from strands_actors.surfaces.failsafe_page import ESTOP, EVENTS, MODES, READER, STORIES, data, page

COMMITTED = Path(__file__).parents[2] / "docs" / "failsafe.html"


def exported() -> dict[str, object]:
    """Return the data that a browser reads from the committed page."""
    found = re.search(r'<script id="machine" type="application/json">(.*?)</script>', COMMITTED.read_text(), re.S)
    assert found is not None
    plain: dict[str, object] = json.loads(found[1])
    return plain


def test_the_committed_page_is_up_to_date() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "strands_actors.surfaces.failsafe_page"], capture_output=True, text=True, check=True
    )
    assert COMMITTED.read_text() == done.stdout == page(), (
        "python -m strands_actors.surfaces.failsafe_page > docs/failsafe.html"
    )


def test_every_mode_event_and_action_is_explained() -> None:
    assert set(MODES) == set(Mode)
    assert set(EVENTS) == {*Event, ESTOP}
    assert set(data()["actions"]) == set(Action)


def looked_up(state: State, event: str) -> tuple[State, str]:
    """Take one step as the page does: by a lookup in the data only."""
    row = exported()["table"][state.mode][event]  # type: ignore[index]
    lock = {"keeps": state.locked_by, "locks": READER, "lifts": ""}[row["lock"]]
    return State(Mode(row["mode"]), state.epoch + row["raises"], lock), row["action"]


@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("locked_by", ["", READER])
def test_the_data_of_the_page_matches_the_machine(mode: Mode, event: str, locked_by: str) -> None:
    before = State(mode, 7, locked_by)
    plain, lock = (Event.STOP, READER) if event == ESTOP else (Event(event), "")
    assert looked_up(before, event) == step(before, plain, lock)
    acts = exported()["table"][mode][event]["acts"]  # type: ignore[index]
    assert acts == ((mode, plain) in TRANSITIONS)


ENDS = {
    "connect and move": State(Mode.ARMED, 2),
    "the policy dies, a new command goes on": State(Mode.ARMED, 3),
    "stop while moving": State(Mode.DISARMED, 3),
    "e-stop, then resume": State(Mode.ARMED, 4),
    "the cable is pulled while moving": State(Mode.DISARMED, 4),
    "stopped during bring-up": State(Mode.DISARMED, 3),
    "the script ends, a resume comes too late": State(Mode.ENDED, 3),
}


@pytest.mark.parametrize("story", STORIES)
def test_a_story_ends_where_the_machine_does(story: str) -> None:
    state = State()
    for event in STORIES[story]:
        plain, lock = (Event.STOP, READER) if event == ESTOP else (Event(event), "")
        state, _ = step(state, plain, lock)
    assert state == ENDS[story]


class References(HTMLParser):
    """Collects all addresses that a browser would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [
            f"{tag} {name}={value}" for name, value in attrs if name in ("src", "href", "srcset", "data")
        ]


def test_the_page_is_one_file() -> None:
    text = COMMITTED.read_text()
    references = References()
    references.feed(text)
    assert references.found == []
    for word in ("http:", "https:", "@import", "fetch(", "XMLHttpRequest", "import("):
        assert word not in text.replace("http://www.w3.org/2000/svg", ""), word
    assert "{{" not in text
