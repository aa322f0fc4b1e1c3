"""A script and its recorder, which somebody else commands as well, which freezes, which dies."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot, Teleoperator, record_dataset
from strands_actors.surfaces.dataset import DatasetError
from strands_actors.surfaces.dataset.dataset import Index
from tests.answers import json_of, until
from tests.teleop.test_page import operator

from .made import check
from .test_page_keys import say, shown


@pytest.fixture
def arm() -> Iterator[Any]:
    with Robot("so101", mode="real", transport="twin") as arm:
        yield arm


def test_what_a_page_is_answered_is_no_answer_to_a_script(arm: Any, tmp_path: Path) -> None:
    root = tmp_path / "set"
    with Teleoperator("page") as page:
        json_of(arm.attach_teleop(page))
        address = until(lambda: page.address, "it is served")
        with record_dataset(arm, root, task="wave") as recording, operator(address) as socket:
            say(socket, "finish")
            shown(socket, lambda told: "no episode runs" in told["said"])
            recording.start()  # is no refusal of the finish before it
            with pytest.raises(DatasetError, match="start: an episode runs"):
                recording.start()
            shown(socket, has_frames)
            say(socket, "finish")
            shown(socket, lambda told: told["said"].endswith("saved"))
            with pytest.raises(DatasetError, match="finish: no episode runs"):
                recording.finish()
            with recording.episode():
                shown(socket, has_frames)
            assert [one["episode"] for one in recording.saved] == [1], "its own"
        json_of(arm.stop_task())
    assert check(root) == len(Index(root).episodes) == 2


def has_frames(told: dict[str, Any]) -> bool:
    return "fps" in told["text"] and ", 0 fps" not in told["text"]
