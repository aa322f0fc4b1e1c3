"""Run a peer with the DDS of Unitree's robots: CycloneDDS 0.10 in a separate process, controlled by lines of
JSON.

    python cyclone_peer.py LIBRARY '{"domain": 78, "config": XML, "reliable": true, "reads": [...], ...}'

A sample is the C struct in hexadecimal digits, or the fields of a request or a response. The peer answers a
request with its text in capitals. It calls the C library directly, since its Python package has no wheel for
our interpreters. ``cyclone_types.json`` has the layout of the types. CycloneDDS's idlc 0.10.2 made it from
Unitree's definitions, with the type information that a robot sends, too.
"""

from __future__ import annotations

import ctypes as c
import json
import os
import select
import struct
import sys
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

TYPES = json.loads((Path(__file__).parent / "cyclone_types.json").read_text())
HG, API = "unitree_hg::msg::dds_::", "unitree_api::msg::dds_::"
TOPICS = {
    "rt/lowcmd": f"{HG}LowCmd_",
    "rt/lowstate": f"{HG}LowState_",
    "rt/api/test/request": f"{API}Request_",
    "rt/api/test/response": f"{API}Response_",
}
REQUEST = struct.Struct("<qqqi?3xQIIQ?7x")  # id, api id, lease, priority, noreply, text, then a sequence of bytes
RESPONSE = struct.Struct("<qqi4xQIIQ?7x")  # id, api id, code, text, then a sequence of bytes
_BEST_EFFORT, _RELIABLE = 0, 1
_VOLATILE, _TRANSIENT_LOCAL = 0, 1
_KEEP_LAST = 0
_DEPTH = 64
_BATCH = 32


class _Serialised(c.Structure):
    _fields_ = [("data", c.c_char_p), ("size", c.c_uint32)]


class _Descriptor(c.Structure):
    """``dds_topic_descriptor_t`` of 0.10."""

    _fields_ = [
        ("size", c.c_uint32),
        ("align", c.c_uint32),
        ("flags", c.c_uint32),
        ("keys_count", c.c_uint32),
        ("name", c.c_char_p),
        ("keys", c.c_void_p),
        ("ops_count", c.c_uint32),
        ("ops", c.POINTER(c.c_uint32)),
        ("meta", c.c_char_p),
        ("info", _Serialised),
        ("map", _Serialised),
        ("representation", c.c_uint32),
    ]


class _SampleInfo(c.Structure):
    _fields_ = [
        ("states", c.c_int * 3),
        ("valid", c.c_bool),
        ("source_ns", c.c_int64),
        ("instance", c.c_uint64),
        ("publication", c.c_uint64),
        ("counts", c.c_uint32 * 5),
    ]


def descriptor(name: str) -> _Descriptor:
    made = TYPES[name]
    ops = (c.c_uint32 * len(made["ops"]))(*made["ops"])
    info, mapping = bytes.fromhex(made["info"]), bytes.fromhex(made["map"])
    return _Descriptor(
        made["size"],
        made["align"],
        made["flags"],
        0,
        name.encode(),
        None,
        made["nops"],
        ops,
        b"",
        _Serialised(info, len(info)),
        _Serialised(mapping, len(mapping)),
        0,
    )


class Peer:
    def __init__(self, library: str, options: dict[str, Any]) -> None:
        self.dds = c.CDLL(library)
        self.dds.dds_create_qos.restype = c.c_void_p
        domain = options["domain"]
        self.domain = self._check(self.dds.dds_create_domain(domain, options["config"].encode()))
        participant = self._check(self.dds.dds_create_participant(domain, None, None))
        qos = c.c_void_p(self.dds.dds_create_qos())
        self.dds.dds_qset_reliability(qos, _RELIABLE if options["reliable"] else _BEST_EFFORT, c.c_int64(10**8))
        self.dds.dds_qset_durability(qos, _TRANSIENT_LOCAL if options["transient_local"] else _VOLATILE)
        self.dds.dds_qset_history(qos, _KEEP_LAST, _DEPTH)
        self.readers, self.writers, self.descriptors = {}, {}, []
        for topic, type_name in TOPICS.items():
            made = descriptor(type_name)
            self.descriptors.append(made)
            entity = self._check(self.dds.dds_create_topic(participant, c.byref(made), topic.encode(), None, None))
            if topic in options["reads"]:
                self.readers[topic] = self._check(self.dds.dds_create_reader(participant, entity, qos, None))
            if topic in options["writes"]:
                self.writers[topic] = self._check(self.dds.dds_create_writer(participant, entity, qos, None))

    def _check(self, value: int) -> int:
        if value < 0:
            raise RuntimeError(f"CycloneDDS answers {value}")
        return value

    def close(self) -> None:
        """Close the domain. This returns when everything is sent. Without closing the domain a thread would
        send the goodbye."""
        self._check(self.dds.dds_delete(self.domain))

    def matched(self, topic: str) -> int:
        status = (c.c_uint32 * 8)()
        self._check(self.dds.dds_get_publication_matched_status(self.writers[topic], c.byref(status)))
        return int(status[2])

    def write(self, topic: str, image: bytes) -> None:
        self._check(self.dds.dds_write(self.writers[topic], c.c_char_p(image)))

    def take(self, topic: str) -> Iterator[bytes]:
        """Yield the C structs of the samples. Each is valid until the next one is requested."""
        reader, size = self.readers[topic], TYPES[TOPICS[topic]]["size"]
        samples = (c.c_void_p * _BATCH)()
        infos = (_SampleInfo * _BATCH)()
        count = self._check(self.dds.dds_take(reader, samples, infos, c.c_size_t(_BATCH), c.c_uint32(_BATCH)))
        for sample, info in zip(samples[:count], infos[:count], strict=True):
            if info.valid and sample:
                yield c.string_at(sample, size)
        if count:
            self._check(self.dds.dds_return_loan(reader, samples, count))


def text_at(address: int) -> str:
    return c.string_at(address).decode()


def request(number: int, api: int, text: str) -> tuple[bytes, list[object]]:
    """Return the C struct, and the objects to which it points."""
    held = c.create_string_buffer(text.encode())
    return REQUEST.pack(number, api, 0, 0, False, c.addressof(held), 0, 0, 0, False), [held]


def response(number: int, api: int, code: int, text: str) -> tuple[bytes, list[object]]:
    held = c.create_string_buffer(text.encode())
    return RESPONSE.pack(number, api, code, c.addressof(held), 0, 0, 0, False), [held]


def serve(peer: Peer) -> None:
    def say(**fields: object) -> None:
        print(json.dumps(fields), flush=True)

    orders: deque[dict[str, Any]] = deque()
    rest = b""
    while True:
        readable, _, _ = select.select([0], [], [], 0.001)
        if readable:
            read = os.read(0, 1 << 16)
            if not read:
                return
            *lines, rest = (rest + read).split(b"\n")
            orders.extend(json.loads(line) for line in lines)
        while orders:
            order = orders.popleft()
            match order["do"]:
                case "write":
                    peer.write(order["topic"], bytes.fromhex(order["image"]))
                case "request":
                    image, held = request(order["id"], order["api"], order["text"])
                    peer.write("rt/api/test/request", image)
                    del held
                case "matched":
                    say(matched=peer.matched(order["topic"]))
        for topic in peer.readers:
            for image in peer.take(topic):
                if TOPICS[topic].startswith(HG):
                    say(topic=topic, image=image.hex())
                elif topic.endswith("request"):
                    number, api, _, _, _, text, *_ = REQUEST.unpack(image)
                    said = text_at(text)
                    say(topic=topic, id=number, api=api, text=said)
                    answer, held = response(number, api, 7, said.upper())
                    peer.write("rt/api/test/response", answer)
                    del held
                else:
                    number, api, code, text, *_ = RESPONSE.unpack(image)
                    say(topic=topic, id=number, api=api, code=code, text=text_at(text))


if __name__ == "__main__":
    served = Peer(sys.argv[1], json.loads(sys.argv[2]))
    print(json.dumps({"ready": True}), flush=True)
    serve(served)
    served.close()
