"""Policy servers of openpi, by ``ws://``: the protocol, a run on the twin, and servers that lie."""

from __future__ import annotations

import contextlib
import math
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.policies.openpi import OpenPi, is_metadata, packed
from strands_actors.policies.remote import Remote
from strands_actors.policies.remote_errors import Misunderstood
from strands_actors.testing import Twin
from tests.answers import why
from tests.robot.helpers import IDS, completed_run

from .openpi_server import array, numbers, openpi_server

AXES = ["a", "b"]


def forward(request: dict[str, Any]) -> Any:
    """Return ten rows that move the first joint by 0.2 degrees a step."""
    state = numbers(request["observation/state"])
    return array([[state[0] + 0.2 * step, *state[1:]] for step in range(1, 11)])


def test_an_openpi_server_drives_the_arm_by_its_address(arm: RealRobot, twin: Twin) -> None:
    with openpi_server(forward) as (port, received):
        report = completed_run(arm, f"ws://127.0.0.1:{port}", seconds=0.6, instruction="pick the cube up")
    assert report["source"] == "server"
    assert received[0].keys() == {"observation/state", "prompt"}
    assert received[0]["prompt"] == "pick the cube up"
    assert len(numbers(received[0]["observation/state"])) == len(IDS)
    # All rows of each chunk are executed, not only the first.
    assert len(received) < len(twin.log.host("setpoint"))


def test_keys_of_a_request_are_options() -> None:
    with (
        openpi_server(lambda request: array([[1.0, 2.0]], "<f8"), {"robot": "aloha"}) as (port, received),
        contextlib.closing(Remote(AXES, "127.0.0.1", port, state_key="state")) as remote,
    ):
        assert remote.get_actions_sync({"a": 3.0, "b": 4.0}, "go") == [{"a": 1.0, "b": 2.0}]
    assert numbers(received[0]["state"]) == [3.0, 4.0]


def test_pictures_of_the_robots_cameras_are_sent_under_their_keys(run_dir: object) -> None:
    camera = {"front": {"width": 64, "height": 48, "fps": 10}}
    with openpi_server(forward) as (port, received), Robot("so101", cameras=camera) as sim:
        images = {"observation/image": "front"}
        completed_run(sim, f"ws://127.0.0.1:{port}", seconds=0.3, images=images)
        picture = received[0]["observation/image"]
        assert (picture[b"dtype"], picture[b"shape"], len(picture[b"data"])) == ("|u1", [48, 64, 3], 48 * 64 * 3)
        answer = sim.run(f"ws://127.0.0.1:{port}", seconds=0.3, images={"observation/image": "wrist"})
        assert "images names wrist, and the robot has cameras front" in why(answer)


def fail(request: dict[str, Any]) -> Any:
    raise KeyError("observation/exterior_image_1_left")


LIES: dict[str, tuple[Any, str]] = {
    "its own error": (fail, "reports an error: KeyError: 'observation/exterior_image_1_left'"),
    "another robot": (lambda request: array([[0.0] * 7]), "sent actions of 7 numbers, and the robot has 6 axes"),
    "nan": (lambda request: array([[math.nan] * 6]), "shoulder_pan is nan"),
    "a text": (lambda request: "go left", "sent a response without an array of actions"),
    "no msgpack": (lambda request: b"\xc1", "sent a response that is not msgpack"),
    "100 MB": (lambda request: bytes(100_000_000), "too big"),
}


def test_saf_014_a_lie_of_an_openpi_server_never_reaches_the_wire(arm: RealRobot, twin: Twin) -> None:
    for lie, (reply, text) in LIES.items():
        with openpi_server(reply) as (port, _):
            answer = arm.run(f"ws://127.0.0.1:{port}", seconds=5.0)
        assert text in why(answer), (lie, answer)
    assert not twin.log.host("setpoint")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (packed("|O", [1, 2], b"cos\nsystem\n"), "of type |O"),
        (packed("<f4", [1, 2], bytes(4)), "do not fit their bytes"),
        (packed("<f4", [10**9, 2], bytes(8)), "do not fit their bytes"),
        (packed("<f4", [0, 2], b""), "not rows of numbers"),
        (packed("<f4", [-1, 2], bytes(8)), "not rows of numbers"),
        (packed("<f4", [1, 1, 2], bytes(8)), "not rows of numbers"),
        (packed("<f4", [2000, 2], bytes(16000)), "do not fit their bytes"),
        ({b"__ndarray__": True}, "not rows of numbers"),
        ([[1.0, 2.0]], "without an array of actions"),
    ],
)
def test_arrays_that_lie_about_themselves_are_refused(value: Any, text: str) -> None:
    import msgspec

    talk = OpenPi()
    talk.apply_setting("keys", AXES)
    with pytest.raises(Misunderstood) as refusal:
        talk.chunk(msgspec.msgpack.encode({"actions": value}))
    assert text in str(refusal.value)


@pytest.mark.parametrize("message", ["{}", b"\xc1", b"\x90", b""])
def test_only_a_map_in_msgpack_is_a_greeting_of_openpi(message: bytes | str) -> None:
    assert not is_metadata(message)
    assert is_metadata(b"\x80")
