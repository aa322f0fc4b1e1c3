"""Rigs of robots on a DDS network: Unitree's robots with legs, Booster's T1."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from strands_actors.drivers.booster import link as booster_link
from strands_actors.drivers.booster import protocol as booster_protocol
from strands_actors.drivers.booster import robots as booster_robots
from strands_actors.drivers.booster.driver import BoosterDriver
from strands_actors.drivers.booster.twin.server import BoosterServer, BoosterTwinOptions
from strands_actors.drivers.common.rtps import discovery, messages, parameters, wire_types
from strands_actors.drivers.common.rtps.discovery import EndpointData, ParticipantData
from strands_actors.drivers.common.rtps.wire_types import (
    PUBLICATIONS_READER,
    PUBLICATIONS_WRITER,
    SPDP_READER,
    SPDP_WRITER,
    SUBSCRIPTIONS_READER,
    SUBSCRIPTIONS_WRITER,
    UNKNOWN,
    reader_id,
    writer_id,
)
from strands_actors.drivers.unitree import link as unitree_link
from strands_actors.drivers.unitree.driver import Go2Driver
from strands_actors.drivers.unitree.protocol import COMMAND_TOPIC, command_type
from strands_actors.drivers.unitree.robots import model_of
from strands_actors.drivers.unitree.twin import UnitreeServer, UnitreeTwinOptions

from .bench import Bench, Rig, first_joint
from .dds_network import PAYLOAD_AT, PREFIX, ROBOT, SEQUENCE_AT, WRITER_AT, Network, in_samples, replaced, said
from .peer import Change, Flood, HostilePeer
from .services import EntryLog

HANDSHAKE = 40
"""Datagrams after which our participant has discovered the robot."""
STATES, ANSWERS = writer_id(1), writer_id(3)
"""Writer ids of the Go2. These two writers are created first, after the reader of commands."""


def _unitree(peer: HostilePeer) -> Bench:
    log = EntryLog()
    server = UnitreeServer(model_of("unitree_go2"), log, UnitreeTwinOptions(host=ROBOT))  # type: ignore[arg-type]
    server.onboard.set_mode("")  # its controller is released, so its joints accept commands
    network = Network(peer)
    driver = Go2Driver("unitree_go2", f"{ROBOT}:7410", {})
    return Bench(driver, lambda: log.entries, lambda: network.serving(server, unitree_link), server.onboard)


def _booster(peer: HostilePeer) -> Bench:
    log = EntryLog()
    server = BoosterServer(booster_robots.model_of("booster_t1"), log, BoosterTwinOptions(host=ROBOT))  # type: ignore[arg-type]
    network = Network(peer)
    driver = BoosterDriver("booster_t1", f"{ROBOT}:7410", {})
    return Bench(driver, lambda: log.entries, lambda: network.serving(server, booster_link), server.onboard)


# -- messages of a hostile participant


def _announcement(number: int) -> bytes:
    """Return an announcement that differs from the one before."""
    where = ((ROBOT, 7410),), ((ROBOT, 7411),)
    data = ParticipantData(PREFIX, *where, 10.0 + number % 2)
    return messages.data(SPDP_READER, SPDP_WRITER, 1, discovery.encode_participant(data))


def _goodbye(number: int) -> bytes:
    guid = PREFIX + wire_types.PARTICIPANT
    key = discovery.encode_ended(guid, parameters.PARTICIPANT_GUID)
    return said(messages.disposal(SPDP_READER, SPDP_WRITER, 2, guid, key), _announcement(0))


def _endpoint(number: int, kind: int, topic: str, type_name: str) -> bytes:
    guid = PREFIX + (1000 + number).to_bytes(3, "big") + bytes((kind,))
    data = EndpointData(guid, topic, type_name, False, 0, ((ROBOT, 1000 + number % 60_000),))
    return discovery.encode_endpoint(data)


def _readers(topic: str, type_name: str) -> Callable[[int], bytes]:
    """Return a flood of new readers, each at another port."""

    def flood(number: int) -> bytes:
        payload = _endpoint(number, 4, topic, type_name)
        return said(messages.data(SUBSCRIPTIONS_READER, SUBSCRIPTIONS_WRITER, 10 + number, payload))

    return flood


def _writers(number: int) -> bytes:
    numbers = range(20 * number, 20 * number + 20)
    topics = ((one, _endpoint(one, 3, f"rt/{one}", "T_")) for one in numbers)
    return said(*(messages.data(PUBLICATIONS_READER, PUBLICATIONS_WRITER, 10 + one, text) for one, text in topics))


def _beats(number: int) -> bytes:
    """Return a datagram full of heartbeats, each of which asks for an acknowledgement."""
    beat = messages.heartbeat(UNKNOWN, PUBLICATIONS_WRITER, 1, 1 << 30, number, final=False)
    return said(beat * 400)


def _repeat(number: int) -> bytes:
    """Return a request to repeat all samples of all our writers."""
    asked = range(1, 17)
    pairs = [
        (SUBSCRIPTIONS_READER, SUBSCRIPTIONS_WRITER),
        (PUBLICATIONS_READER, PUBLICATIONS_WRITER),
        *((reader_id(reader), writer_id(writer)) for reader in (2, 4, 6, 8) for writer in range(1, 5)),
    ]
    return said(*(messages.acknack(*pair, 1, asked, number, final=False) for pair in pairs))


def _gaps(number: int) -> bytes:
    return said(messages.gap(UNKNOWN, ANSWERS, 1 + number, 1 << 40) * 400)


def _states(number: int) -> bytes:
    return said(messages.data(UNKNOWN, STATES, 1_000_000 + number, b"\0\1\0\0" + bytes(1000)))


def _fragments(total: int) -> Callable[[int], bytes]:
    """Return a flood of first fragments, each of another sample with ``total`` bytes."""

    def flood(number: int) -> bytes:
        fixed = wire_types.LITTLE.fragment.pack(
            0, 28, UNKNOWN, ANSWERS, 0, 1 + number % 200, 1, 1, max(1000, total >> 16), total
        )
        body = fixed + bytes(max(1000, total >> 16))
        return said(bytes((0x16, 1)) + len(body).to_bytes(2, "little") + body)

    return flood


def _floods(topic: str, type_name: str) -> Mapping[str, Flood]:
    return {
        "heartbeats": _beats,
        "announcements": said(*map(_announcement, range(400))),
        "goodbyes": _goodbye,
        "questions": _repeat,
        "readers": _readers(topic, type_name),
        "writers": _writers,
        "gaps": _gaps,
        "empty states": _states,
        "fragments": _fragments(200_000),
        "noise": b"\0" * 64,
        "empty messages": said(),
    }


_BOMBS: Mapping[str, Flood] = {
    "a sample of 64 MB": _fragments(64 << 20),
    "samples of 256 kB": _fragments(256 << 10),
    "early samples": lambda number: said(
        messages.data(UNKNOWN, ANSWERS, 2 + number % 250, b"\0\1\0\0" + bytes(60_000))
    ),
    "a submessage without an end": said(b"\x15\x01\xff\xff"),
    "endpoints": _writers,
}


def _another_participant(data: bytes) -> bytes:
    return data[:8] + bytes((data[8] ^ 1,)) + data[9:]


def _wrong_ids(number_at: int, answers: bytes) -> Mapping[str, Change]:
    return {
        "answer": in_samples(replaced(PAYLOAD_AT + number_at, b"\x55" * 4), answers),
        "participant": _another_participant,
        "writer": in_samples(replaced(WRITER_AT, b"\x77\x77\x77\x03")),
        "sequence": in_samples(replaced(SEQUENCE_AT, (1 << 20).to_bytes(4, "little"))),
        "the same sequence": in_samples(replaced(SEQUENCE_AT, (1).to_bytes(4, "little"))),
    }


RIGS: Mapping[str, Rig] = {
    "unitree_go2": Rig(
        _unitree,
        first_joint(0.002, "FR_hip_joint"),
        quick=("garbled", "flood", "older answers"),
        floods=_floods(COMMAND_TOPIC, command_type("go")),
        bombs=_BOMBS,
        wrong_ids=_wrong_ids(0, ANSWERS),
        understood=("answer",),  # a stop is confirmed by states
        handshake=HANDSHAKE,
        bound_s=0.01,
    ),
    "booster_t1": Rig(
        _booster,
        lambda position: {"left_shoulder_roll": position[1] + 0.002},
        quick=("garbled", "wrong ids"),
        floods=_floods(booster_protocol.topic("joint_ctrl", ""), booster_protocol.COMMAND_TYPE),
        bombs=_BOMBS,
        wrong_ids=_wrong_ids(4, writer_id(5)),
        handshake=HANDSHAKE,
        first=("enable_upper_body",),
    ),
}
