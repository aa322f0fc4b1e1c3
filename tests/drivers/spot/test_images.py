"""Test the pictures of the twin's cameras: their shape, what they show, and what the service refuses."""

from __future__ import annotations

import ssl
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from strands_actors.contract.extras import EXTRAS
from strands_actors.drivers.common.ports.tls_port import TlsRecords
from strands_actors.drivers.common.twin import Connection
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message
from strands_actors.drivers.spot.twin import SpotTwin
from strands_actors.drivers.spot.twin.cameras import (
    DEPTH,
    GREY,
    JPEG,
    NO_DATA,
    NO_FORMAT,
    NO_PIXEL_FORMAT,
    NO_RATIO,
    RAW,
    RGB,
    UNKNOWN_CAMERA,
    jpeg,
    sources_of,
)
from strands_actors.drivers.spot.twin.geometry import Pose, pose_at
from strands_actors.drivers.spot.twin.pictures import FARTHEST_M, TILE_M, Lens, colour, depth
from strands_actors.drivers.spot.twin.tls import TlsConnection, certificate, server_context
from tests.drivers.common.memory_port import virtual

from .test_hand import standing

DOWN = pose_at(0.0, 0.0, 2.0, roll=np.pi)
"""A camera two metres above the floor that looks straight down, its x axis forwards."""


def taken(twin: SpotTwin, name: str, **request: Any) -> Message:
    reply, logged = twin.answer("GetImage", {"image_requests": [{"image_source_name": name, **request}]})
    assert logged == ("read", None)
    (response,) = reply["image_responses"]
    found: Message = response
    return found


def decoded(response: Message) -> np.ndarray[Any, Any]:
    """Return the picture of a response, as the vendor's examples decode it."""
    image = response["shot"]["image"]
    data = np.frombuffer(image["data"], dtype=np.uint16 if image["pixel_format"] == DEPTH else np.uint8)
    if image["format"] == JPEG:
        picture = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
        assert picture is not None
        return picture
    return data.reshape((image["rows"], image["cols"], -1))


# -- what is seen


def test_a_camera_that_looks_straight_down_measures_its_height_everywhere() -> None:
    lens = Lens(64, 48, 40.0)
    far = depth(lens, DOWN)
    assert far.shape == (48, 64) and far.dtype == np.uint16 and set(np.unique(far)) == {2000}
    assert not depth(lens, pose_at(0.0, 0.0, 2.0)).any(), "a camera that looks up sees no floor"
    assert not depth(lens, pose_at(0.0, 0.0, FARTHEST_M + 1.0, roll=np.pi)).any()


def test_the_tiles_of_the_floor_stay_where_they_are() -> None:
    lens = Lens(64, 48, 40.0)
    still, moved = colour(lens, DOWN), colour(lens, Pose((2 * TILE_M, 0.0, 2.0), DOWN.rotation))
    half = colour(lens, Pose((TILE_M, 0.0, 2.0), DOWN.rotation))
    assert np.array_equal(still, moved), "the pattern repeats after two tiles"
    assert not np.array_equal(still, half)
    assert still.shape == (48, 64, 3) and len(np.unique(still.reshape(-1, 3), axis=0)) == 2


def test_the_front_cameras_see_the_floor_nearer_below_and_the_sky_above() -> None:
    async def test() -> None:
        twin = standing()
        # The picture of a front camera lies on its side (example get_image).
        far = np.rot90(decoded(taken(twin, "frontleft_depth_in_visual_frame"))[:, :, 0], -1)
        columns = far[:, far.shape[1] // 2]
        measured = columns[columns > 0]
        assert len(measured) > 300 and list(measured) == sorted(measured, reverse=True)
        assert not columns[: np.argmax(columns > 0)].any(), "above the floor nothing is measured"
        twin.mechanism.up = 0.0
        twin.mechanism.wants_up = False
        lower = np.rot90(decoded(taken(twin, "frontleft_depth_in_visual_frame"))[:, :, 0], -1)
        assert lower[-1, 240] < far[-1, 240], "a sitting robot is nearer to the floor"

    virtual(test)


def test_a_picture_changes_with_the_hand_that_takes_it() -> None:
    async def test() -> None:
        twin = standing()
        before = decoded(taken(twin, "hand_color_image", resize_ratio=0.25))
        assert np.array_equal(before, decoded(taken(twin, "hand_color_image", resize_ratio=0.25)))
        twin.mechanism.joints[0] = 0.5
        assert not np.array_equal(before, decoded(taken(twin, "hand_color_image", resize_ratio=0.25)))

    virtual(test)


# -- the answer


@pytest.mark.parametrize("name", list(sources_of(True)))
def test_each_source_has_the_picture_that_its_description_promises(name: str) -> None:
    async def test() -> None:
        twin = standing()
        listed = {source["name"]: source for source in twin.answer("ListImageSources", {})[0]["image_sources"]}
        response = taken(twin, name, quality_percent=75.0)
        image = response["shot"]["image"]
        assert response["status"] == p.OK and response["source"] == listed[name]
        picture = decoded(response)
        assert picture.shape[:2] == (listed[name]["rows"], listed[name]["cols"]) == (image["rows"], image["cols"])
        is_depth = listed[name]["image_type"] == 2
        assert (
            image["format"] == (RAW if is_depth else JPEG)
            and image["pixel_format"] in listed[name]["pixel_formats"]
        )
        assert (listed[name].get("depth_scale") == 1000.0) is is_depth
        frames = {edge["key"]: edge["value"] for edge in response["shot"]["transforms_snapshot"]["edges"]}
        frame = response["shot"]["frame_name_image_sensor"]
        while frame != "body":
            frame = frames[frame]["parent_frame_name"]
        assert np.ptp(picture) > 10, "the floor is seen"

    virtual(test)


def test_a_robot_without_an_arm_has_no_camera_in_its_hand() -> None:
    async def test() -> None:
        twin = standing(arm=False)
        names = {source["name"] for source in twin.answer("ListImageSources", {})[0]["image_sources"]}
        assert len(names) == 15 and not any(name.startswith("hand") for name in names)
        assert taken(twin, "hand_depth") == {"status": UNKNOWN_CAMERA}

    virtual(test)


def test_formats_and_sizes_are_those_that_are_requested() -> None:
    async def test() -> None:
        twin = standing()
        small = taken(twin, "hand_color_image", resize_ratio=0.5, pixel_format=GREY, image_format=RAW)
        assert small["shot"]["image"]["pixel_format"] == GREY and decoded(small).shape == (240, 320, 1)
        focal = small["source"]["pinhole"]["intrinsics"]["focal_length"]["x"]
        assert focal == 276.0, "half the size is half the focal length"
        fallback = taken(twin, "left_fisheye_image", pixel_format=RGB, fallback_formats=[DEPTH, GREY])
        assert fallback["shot"]["image"]["pixel_format"] == GREY
        best, worst = (taken(twin, "left_fisheye_image", quality_percent=q) for q in (100.0, 5.0))
        assert len(best["shot"]["image"]["data"]) > len(worst["shot"]["image"]["data"])

    virtual(test)


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        ({"image_source_name": "front"}, UNKNOWN_CAMERA),
        ({"image_source_name": "back_depth", "image_format": JPEG}, NO_FORMAT),
        ({"image_source_name": "left_fisheye_image", "image_format": 3}, NO_FORMAT),
        ({"image_source_name": "left_fisheye_image", "pixel_format": RGB}, NO_PIXEL_FORMAT),
        ({"image_source_name": "back_depth", "resize_ratio": 2.0}, NO_RATIO),
    ],
)
def test_what_a_camera_does_not_have_is_refused_with_the_vendors_status(request_: Message, status: int) -> None:
    async def test() -> None:
        reply, _ = standing().answer("GetImage", {"image_requests": [request_]})
        assert reply == {"image_responses": [{"status": status}]}

    virtual(test)


def test_an_answer_that_would_be_too_long_says_so_for_each_picture() -> None:
    async def test() -> None:
        names = ["left_depth_in_visual_frame"] * 14 + ["back_depth"]
        requests = [{"image_source_name": name} for name in names]
        responses = standing().answer("GetImage", {"image_requests": requests})[0]["image_responses"]
        assert [response["status"] for response in responses] == [p.OK] * 13 + [NO_DATA, p.OK]
        assert "shot" not in responses[13] and responses[13]["source"]["name"] == names[13]

    virtual(test)


def test_comments_of_operators_are_kept() -> None:
    async def test() -> None:
        twin = standing()
        comment = {"message": "hello", "timestamp": p.stamp(5)}
        assert twin.answer("RecordOperatorComments", {"operator_comments": [comment]})[0] == {}
        assert twin.comments == [comment]

    virtual(test)


# -- JPEG


def colours(data: bytes) -> NDArray[np.uint8]:
    read = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert read is not None
    return cv2.cvtColor(read, cv2.COLOR_BGR2RGB).astype(np.uint8)


def test_a_file_has_the_colours_of_its_picture_in_their_order() -> None:
    picture = np.zeros((48, 64, 3), np.uint8)
    picture[:, :32, 0], picture[:, 32:, 2] = 200, 90
    assert np.abs(colours(jpeg(picture, 100.0)).astype(float) - picture).mean() < 3.0
    assert len(jpeg(picture, 10.0)) < len(jpeg(picture, 100.0))


def test_without_opencv_a_source_offers_raw_pictures_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(EXTRAS, "cameras", ("no_such_module",))

    async def test() -> None:
        listed, _ = standing().answer("ListImageSources", {})
        assert all(source["image_formats"] == [RAW] for source in listed["image_sources"])
        assert taken(standing(), "left_fisheye_image")["shot"]["image"]["format"] == RAW

    virtual(test)


# -- a long answer


class Narrow(Connection):
    """A connection whose client takes few bytes at a time."""

    def __init__(self, arriving: list[bytes]) -> None:
        self.arriving = arriving
        self.log = self.frost = None  # type: ignore[assignment]
        self.room = 1 << 20
        self.taken = b""
        self.aborted = False

    async def receive(self) -> tuple[int, bytes]:
        return 0, self.arriving.pop(0)

    def send_part(self, data: bytes) -> int:
        sent, self.room = data[: self.room], max(0, self.room - len(data))
        self.taken += sent
        return len(sent)

    def abort(self) -> None:
        self.aborted = True


async def tls_pair() -> tuple[TlsRecords, TlsConnection, Narrow]:
    """Return the client's end, the twin's end, and what is between them, after the handshake."""
    client = TlsRecords(ssl.create_default_context(cafile=certificate("ca.pem")), "api.spot.robot")
    below = Narrow([])
    twin = TlsConnection(below, server_context())
    client.decrypt(b"")
    below.arriving.append(client.outgoing())
    with pytest.raises(IndexError):  # the twin waits for the rest of the handshake
        await twin.shake_hands()
    client.decrypt(below.taken)
    below.taken = b""
    below.arriving.append(client.outgoing())
    await twin.shake_hands()
    client.decrypt(below.taken)
    below.taken = b""
    return client, twin, below


def test_a_client_with_little_room_gets_a_whole_picture_and_one_that_never_reads_is_disconnected() -> None:
    async def test() -> None:
        client, twin, below = await tls_pair()
        picture, read = bytes(range(256)) * 4000, b""
        below.room = 0
        twin.send(picture)
        assert below.taken == b"" and not below.aborted
        while len(read) < len(picture):
            below.room = 70_000
            twin.push()
            assert below.taken, "a part arrives at each step"
            read += client.decrypt(below.taken)
            below.taken = b""
        assert read == picture
        below.room = 0
        for _ in range(20):
            twin.send(picture)
        assert below.aborted

    virtual(test)
