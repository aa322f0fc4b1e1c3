"""A twin as a separate process, with its port, its log and its control lines."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import serial

from strands_actors.testing.fork_server import Forked, twin_server
from tests.answers import PATIENCE_S, until


class TwinProcess:
    def __init__(self, directory: Path, robot: str = "so101", wire: str = "feetech", **arguments: Any) -> None:
        self.log_path = directory / "wire.ndjson"
        self.port_file = directory / "port"
        self._wire = wire
        self._arguments = {
            "robot": robot,
            "port_file": str(self.port_file),
            "log": str(self.log_path),
            **arguments,
        }

    def __enter__(self) -> TwinProcess:
        main = f"strands_actors.drivers.{self._wire}.twin:main"
        arguments = {**self._arguments}
        inherited = arguments.pop("parent_fd", None)
        (stdin, ours), (said, stderr) = os.pipe(), os.pipe()
        lines, errors = open(ours, "wb"), open(said, "rb")
        forks = twin_server()
        try:
            pid = forks.fork(main, arguments, (stdin, stderr), parent=inherited)
        finally:
            os.close(stdin)
            os.close(stderr)
        self.process = Forked(forks, pid, lines, errors)
        until(lambda: self.port_file.exists() or self.process.poll() is not None, "serving")
        if self.process.poll() is not None:
            _, error = self.process.communicate()
            raise RuntimeError((error or b"").decode())
        self.port = self.port_file.read_text()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.terminate()
        self.process.communicate(timeout=PATIENCE_S)

    def command(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line.encode() + b"\n")
        self.process.stdin.flush()

    def log(self) -> list[Mapping[str, Any]]:
        *lines, _unfinished = self.log_path.read_text().split("\n")  # the twin may be writing its last line
        return [json.loads(line) for line in lines]

    def logged(self, source: str) -> list[tuple[str, str]]:
        """Return kind and hex of every frame from one side."""
        return [(line["kind"], line["hex"]) for line in self.log() if line["from"] == source]

    def connect(self, rate: int = 1_000_000) -> serial.Serial:
        until(lambda: os.path.exists(self.port), "the port appears")
        return serial.Serial(self.port, rate, timeout=PATIENCE_S)
