"""The arguments of a robot of parts, and what its driver makes of those of the parts. Nothing is started."""

from __future__ import annotations

from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.contract.driver import GateState, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

make: Any = Robot
"""``Robot``, whose signatures do not list the keywords of parts."""

ARMS = {"left": {"robot": "so101", "port": "/dev/l"}, "right": {"robot": "so101", "port": "/dev/r"}}


def test_keys_of_two_arms_are_those_of_lerobot_and_others_have_a_dot() -> None:
    assert make("bi_so101", transport="twin", mode="real").driver.axes[0] == "left_shoulder_pan"
    assert make("cell", mode="real", parts=ARMS).driver.axes[6] == "right.shoulder_pan"


def test_the_most_severe_safe_state_of_the_parts_is_that_of_the_robot() -> None:
    parts = {"base": {"robot": "earthrover"}, "arm": {"robot": "so101", "on_exit": "limp"}}
    driver = make("cell", mode="real", transport="twin", parts=parts).driver
    assert (driver.fallbacks[Reason.LEASE], driver.fallbacks[Reason.STOP]) == (SafeState.ZERO, SafeState.LIMP)


def test_an_action_is_checked_by_every_part() -> None:
    driver = make("cell", mode="real", parts=ARMS).driver
    rows = (0.0,) * 12
    state = GateState(1, Observation(1, rows, (1,) * 12), rows, 1, stream=False)
    parsed = driver.parse({"left.shoulder_pan": 1.0, "right_elbow_flex.pos": 2.0}, state)
    assert not isinstance(parsed, Refused) and parsed.named == (0, 8) and parsed.values[8] == 2.0
    twice = driver.parse({"left.gripper": 1.0, "left_gripper": 2.0}, state)
    assert isinstance(twice, Refused) and twice.code == Code.BOTH_SPELLINGS
    unknown = driver.parse({"middle.gripper": 1.0}, state)
    assert isinstance(unknown, Refused) and unknown.code == Code.UNKNOWN_JOINT


@pytest.mark.parametrize(
    ("keywords", "error", "text"),
    [
        ({"parts": {"left": {"robot": "so101"}}}, ValueError, "Give at least two"),
        ({"parts": 3}, TypeError, "Give keywords by part"),
        ({"parts": {"left": {}, "right": {"robot": "so101"}}}, ValueError, "part left of cell has no robot"),
        ({"parts": ARMS, "port": "x"}, TypeError, "takes no port= itself"),
        ({"parts": {**ARMS, "left": {**ARMS["left"], "id": "x"}}}, TypeError, "id= is for the whole robot"),
    ],
)
def test_wrong_arguments_are_refused(keywords: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        make("cell", mode="real", **keywords)
