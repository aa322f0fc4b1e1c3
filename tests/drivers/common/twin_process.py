"""A twin as a process of its own, with its port, its log and its control lines."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import serial

PATIENCE_S = 20.0
"""For a busy machine; nothing here takes a second on a free one."""

PROGRAM = """
import importlib, json, sys
importlib.import_module(f"strands_actors.drivers.{sys.argv[1]}.twin").main(**json.loads(sys.argv[2]))
"""


def wait_until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(f"not after {PATIENCE_S} s: {what}")
        time.sleep(0.005)


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
        inherited = self._arguments.get("parent_fd")
        self.process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, self._wire, json.dumps(self._arguments)],
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            pass_fds=() if inherited is None else (inherited,),
        )
        wait_until(lambda: self.port_file.exists() or self.process.poll() is not None, "serving")
        if self.process.poll() is not None:
            _, error = self.process.communicate()
            raise RuntimeError(error.decode())
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
        """Kind and hex of every frame of one side."""
        return [(line["kind"], line["hex"]) for line in self.log() if line["from"] == source]

    def connect(self, rate: int = 1_000_000) -> serial.Serial:
        wait_until(lambda: os.path.exists(self.port), "the port appears")
        return serial.Serial(self.port, rate, timeout=PATIENCE_S)
