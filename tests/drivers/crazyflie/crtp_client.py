"""A small independent client of CRTP over UDP, without code of the package: ``python crtp_client.py HOST
PORT``.

It does what a ground station does, and prints its results as JSON.
"""

from __future__ import annotations

import json
import socket
import struct
import sys
import time

LOG_WANTED = {"stateEstimate.z": "<f", "stabilizer.yaw": "<f", "pm.vbat": "<f"}


class Client:
    def __init__(self, host: str, port: int) -> None:
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.connect((host, port))
        self.sock.settimeout(2.0)
        self.rows: list[bytes] = []

    def send(self, port: int, channel: int, data: bytes) -> None:
        self.sock.send(bytes([port << 4 | 0x0C | channel]) + data)

    def ask(self, port: int, channel: int, data: bytes, begins: bytes = b"") -> bytes:
        self.send(port, channel, data)
        while True:
            packet = self.sock.recv(64)
            if (packet[0] >> 4, packet[0] & 3) == (port, channel) and packet[1:].startswith(begins):
                return packet[1:]
            if packet[0] >> 4 == 5 and packet[0] & 3 == 2:
                self.rows.append(packet[1:])

    def table(self, port: int) -> dict[str, tuple[int, int]]:
        """Return number and type of each name."""
        count = struct.unpack("<H", self.ask(port, 0, b"\3", b"\3")[1:3])[0]
        found = {}
        for number in range(count):
            head = struct.pack("<BH", 2, number)
            item = self.ask(port, 0, head, head)
            group, name = item[4:].split(b"\0")[:2]
            found[f"{group.decode()}.{name.decode()}"] = number, item[3]
        return found

    def receive(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0:
            self.sock.settimeout(left_s)
            try:
                packet = self.sock.recv(64)
            except TimeoutError:
                break
            if packet[0] >> 4 == 5 and packet[0] & 3 == 2:
                self.rows.append(packet[1:])
        self.sock.settimeout(2.0)

    def last(self) -> tuple[float, ...]:
        return struct.unpack("<fff", self.rows[-1][4:])

    def bits(self) -> int:
        answer = self.ask(9, 0, b"\x0c", b"\x8c")
        return int(struct.unpack("<H", answer[1:3])[0])


def main(host: str, port: int) -> dict[str, object]:
    client = Client(host, port)
    client.sock.send(b"\xff")
    seen: dict[str, object] = {"answers_a_scan": client.sock.recv(64).hex()}
    seen["name"] = client.ask(15, 1, b"").split(b"\0")[0].decode()
    seen["protocol"] = client.ask(13, 1, b"\0", b"\0")[1]
    logs, parameters = client.table(5), client.table(2)
    seen["log"], seen["parameters"] = sorted(logs), sorted(parameters)
    estimator = struct.pack("<H", parameters["stabilizer.estimator"][0])
    seen["read"] = client.ask(2, 1, estimator, estimator)[3]
    seen["written"] = client.ask(2, 2, estimator + b"\1", estimator)[2]
    client.ask(5, 1, b"\5", b"\5")
    block = b"".join(struct.pack("<BH", 7, logs[name][0]) for name in LOG_WANTED)
    seen["block"] = [client.ask(5, 1, b"\6\7" + block, b"\6\7")[2], client.ask(5, 1, b"\3\7\2", b"\3\7")[2]]
    seen["before"] = client.bits()
    seen["armed"] = list(client.ask(9, 1, b"\1\1", b"\x81"))
    began_s = time.monotonic()
    while time.monotonic() < began_s + 2.0:
        client.send(7, 0, struct.pack("<Bffff", 10, 0.0, 0.0, 45.0, 0.5))
        client.receive(0.05)
    seen["up"], seen["rows"] = client.last(), len(client.rows)
    seen["flying"] = client.bits()
    client.send(7, 1, struct.pack("<BI", 0, 0))
    seen["land"] = list(client.ask(8, 0, struct.pack("<BBff?f", 8, 0, 0.0, 0.0, True, 1.0)))
    client.receive(1.8)
    seen["down"], seen["landed"] = client.last(), client.bits()
    return seen


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1], int(sys.argv[2]))))
