"""Policy servers of GR00T, by ``zmq://``: both generations of the protocol, a run on the twin, and lies."""

from __future__ import annotations

import contextlib
import io
import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.policies.groot import Modalities, joints_of
from strands_actors.policies.groot_client import Groot
from strands_actors.testing import Twin
from tests.answers import why
from tests.robot.helpers import IDS, completed_run

from .groot_server import MODALITIES, Act, flat, groot_server, nested, numbers, packed

AXES = list(IDS)
ARM = [axis for axis in AXES if axis != "gripper"]
REST = dict.fromkeys(AXES, 1.0)
TEXT = "annotation.human.task_description"
FRONT = {"video": {"modality_keys": ["front"], "delta_indices": [0]}}


@pytest.mark.parametrize("act", [nested, flat])
def test_a_groot_server_drives_the_arm_by_its_address(arm: RealRobot, twin: Twin, act: Act) -> None:
    with groot_server(act) as (port, received):
        report = completed_run(arm, f"zmq://127.0.0.1:{port}", seconds=0.6, instruction="pick the cube up")
    assert report["source"] == "server"
    data = next(request["data"] for request in received if request["endpoint"] == "get_action")
    if act is nested:
        assert data["observation"]["language"] == {TEXT: [["pick the cube up"]]}
        assert numbers(data["observation"]["state"]["single_arm"]).shape == (1, 1, 5)
        assert "reset" in [request["endpoint"] for request in received]
    else:
        assert data[TEXT] == ["pick the cube up"]
        assert numbers(data["state.single_arm"]).shape == (1, 5)
    # All rows of each chunk are executed, not only the first.
    assert len(received) < len(twin.log.host("setpoint"))


def test_the_keys_and_the_token_are_options() -> None:
    joints = {"single_arm": ARM[::-1], "gripper": ["gripper"]}
    with (
        groot_server(token="secret") as (port, _),
        contextlib.closing(Groot(AXES, "127.0.0.1", port, api_token="secret", joints=joints)) as client,
    ):
        chunk = client.get_actions_sync(REST, "go")
        with pytest.raises(ConnectionError, match="Unauthorized: Invalid API token"):
            Groot(AXES, "127.0.0.1", port)
    assert len(chunk) == 16 and chunk[0] == pytest.approx({**REST, ARM[-1]: 1.2})


def test_pictures_are_sent_under_their_keys(run_dir: object) -> None:
    camera = {"front": {"width": 64, "height": 48, "fps": 10}}
    with (
        groot_server(modalities={**MODALITIES, **FRONT}) as (port, received),
        Robot("so101", cameras=camera) as sim,
    ):
        completed_run(sim, f"zmq://127.0.0.1:{port}", seconds=0.3)
        data = next(request["data"] for request in received if request["endpoint"] == "get_action")
        picture = numbers(data["observation"]["video"]["front"])
        assert (picture.shape, picture.dtype) == ((1, 1, 48, 64, 3), np.uint8)
        answer = sim.run(f"zmq://127.0.0.1:{port}", seconds=0.3, images={"front": "wrist"})
        assert "images names wrist, and the robot has cameras front" in why(answer)


def of_arm(array: Any) -> Act:
    """Return a server's answers with this array for the five joints of the arm."""
    return lambda data: [{"single_arm": array, "gripper": packed(np.zeros((1, 16, 1)))}, {}]


def fail(data: dict[str, Any]) -> Any:
    raise KeyError("CUDA out of memory")


def late(data: dict[str, Any]) -> Any:
    time.sleep(1.0)
    return nested(data)


def huge(data: dict[str, Any]) -> bytes:
    return bytes(100_000_000)


def pickled() -> dict[str, Any]:
    file = io.BytesIO()
    np.save(file, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    return {"__ndarray_class__": True, "as_npy": file.getvalue()}


def boastful() -> dict[str, Any]:
    """Return an array of 80 bytes that states a shape of a terabyte."""
    file = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (1, 10**6, 10**5)}
    np.lib.format.write_array_header_1_0(file, header)  # type: ignore[no-untyped-call]
    return {"__ndarray_class__": True, "as_npy": file.getvalue() + bytes(80)}


LIES: dict[str, tuple[Act, str]] = {
    "its own error": (fail, "reports an error: 'CUDA out of memory'"),
    "another robot": (of_arm(packed(np.zeros((1, 16, 7)))), "of shape [1, 16, 7], and the robot has 5 axes"),
    "no rows": (of_arm(packed(np.zeros((1, 0, 5)))), "of shape [1, 0, 5]"),
    "a text": (lambda data: "go left", "sent a response without actions"),
    "a text for an array": (of_arm("left"), "sent 'single_arm' as str, not as an array"),
    "unknown axes": (lambda data: [{"left_arm": packed([1.0])}, {}], "sent actions without 'single_arm': left_arm"),
    "a pickle": (of_arm(pickled()), "as object of shape"),
    "a terabyte": (of_arm(boastful()), "not as an array of numbers"),
    "no msgpack": (lambda data: b"\xc1", "sent a response that is not msgpack"),
    "100 MB": (huge, "sent a message of more than"),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_lie_of_a_groot_server_is_refused_by_name(lie: str) -> None:
    act, text = LIES[lie]
    with (
        groot_server(act) as (port, _),
        contextlib.closing(Groot(AXES, "127.0.0.1", port)) as client,
        pytest.raises(ConnectionError) as seen,
    ):
        client.get_actions_sync(REST, "go")
    assert str(seen.value).startswith(f"zmq://127.0.0.1:{port} ") and text in str(seen.value)


def test_saf_014_a_lie_of_a_groot_server_never_reaches_the_wire(arm: RealRobot, twin: Twin) -> None:
    nan = of_arm(packed(np.full((1, 16, 5), math.nan)))
    cases = (
        (nan, 9.0, "shoulder_pan is nan"),
        (late, 0.3, "did not answer within 0.3 s"),
        (huge, 9.0, "more than"),
    )
    for act, timeout_s, text in cases:
        with groot_server(act) as (port, _):
            assert text in why(arm.run(f"zmq://127.0.0.1:{port}", seconds=5.0, timeout_s=timeout_s))
    assert not twin.log.host("setpoint")


@pytest.mark.parametrize(
    ("modalities", "text"),
    [
        ({"state": {**MODALITIES["state"], "delta_indices": [-1, 0]}}, "reads 2 of 'state' at once"),
        ({"action": {"modality_keys": [5], "delta_indices": [0]}}, "describes its modality 'action' wrongly"),
    ],
)
def test_a_description_that_cannot_be_used_is_refused(modalities: Mapping[str, Any], text: str) -> None:
    with groot_server(modalities={**MODALITIES, **modalities}) as (port, _), pytest.raises(ConnectionError) as seen:
        Groot(AXES, "127.0.0.1", port)
    assert text in str(seen.value)


KEYS = {"state": ("single_arm", "gripper"), "action": ("single_arm", "gripper"), "video": (), "language": ()}


@pytest.mark.parametrize(
    ("keys", "given", "text"),
    [
        ({**KEYS, "action": ("left_arm", "right_arm")}, None, "Give joints"),
        (KEYS, {"single_arm": ["elbow"], "gripper": ["gripper"]}, "each with axes of"),
        (KEYS, {"single_arm": ARM}, "Give the keys single_arm, gripper"),
        (KEYS, {"single_arm": AXES, "gripper": ["gripper"]}, "each axis once"),
    ],
)
def test_axes_that_do_not_fit_the_keys_are_refused(keys: Any, given: Any, text: str) -> None:
    with pytest.raises(ValueError) as seen:
        joints_of(Modalities(True, keys), AXES, given)
    assert text in str(seen.value)


def test_one_key_is_the_whole_robot() -> None:
    keys = {**KEYS, "state": ("all",), "action": ("all",)}
    assert joints_of(Modalities(True, keys), AXES, None) == {"all": tuple(AXES)}


def test_a_server_that_is_not_there_is_reported() -> None:
    with pytest.raises(TimeoutError, match=r"zmq://127.0.0.1:9 did not answer within"):
        Groot(AXES, "127.0.0.1", 9, timeout_s=0.2)
