"""The policy ``onnx``: a network in the ONNX format, run in the policy's process by onnxruntime."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from strands_actors.contract.axis import Axis, AxisMode
from strands_actors.contract.wire import Observation

from .folder import manifest_of
from .manifest import (
    ActionKind,
    Block,
    Command,
    Constant,
    Gravity,
    LastAction,
    Position,
    SensorValues,
    Velocity,
    command_of,
    factor_of,
)
from .network import Network

RPY = "rpy_rad"
HZ_TOLERANCE = 0.01
"""Share by which the control rate may differ from that of the manifest."""


class OnnxPolicy:
    """Load the network of a folder and run it as a policy.

    Args:
        axes: Names of the robot's axes.
        folder: The folder, with ``manifest.json`` and the network.
        skill: The policy of a set, by its name; empty if the folder has only one.
        command: Numbers for the block ``command`` of the manifest, from its first one on.

    Raises:
        ValueError: The manifest is wrong, or does not fit the network or the robot.
    """

    provider_name = "onnx"
    requires_images = False
    reads_instruction = False

    def __init__(
        self, axes: Sequence[str], folder: str = "", skill: str = "", command: Sequence[float] = ()
    ) -> None:
        if not folder:
            raise ValueError("onnx: no folder is given. Set folder to the folder of manifest.json")
        manifest = manifest_of(Path(folder), skill)
        assert manifest is not None  # ``skill`` is given
        self._manifest = manifest
        names = [joint.name for joint in manifest.joints]
        if unknown := [name for name in names if name not in axes]:
            raise ValueError(
                f"onnx: {folder} commands {', '.join(unknown)[:200]}, and the robot has {', '.join(axes)}. Use a "
                "policy of this robot"
            )
        self._command = command_of(manifest, command)
        self._index = [list(axes).index(name) for name in names]
        self._factors = [math.nan] * len(names)
        self._ranges = [(-math.inf, math.inf)] * len(names)
        self._reading: Observation | None = None
        self._network = Network(
            Path(folder) / manifest.file, manifest.inputs, manifest.action.chunk, len(manifest.joints)
        )
        self.reset()

    @property
    def control_hz(self) -> float:
        """The number of actions per second that the manifest states."""
        return self._manifest.control_hz

    def set_robot_axes(self, axes: Sequence[Axis]) -> None:
        """Set the units of the robot's axes. Raise ``ValueError`` if a joint of the manifest has another one."""
        table = {axis.key: axis for axis in axes}
        for number, joint in enumerate(self._manifest.joints):
            axis = table[joint.name]
            factor = factor_of(axis.unit, joint.unit)
            if factor is None or axis.mode is not AxisMode.POSITION:
                raise ValueError(
                    f"onnx: the manifest has {joint.name} in {joint.unit[:100]!r}, and the robot takes a "
                    f"{axis.mode} in {axis.unit!r}. Correct the unit in the manifest"
                )
            self._factors[number] = factor
            if self._manifest.action.clip:
                self._ranges[number] = (axis.low, axis.high)

    def set_control_frequency(self, hz: float) -> None:
        """Check the rate at which the actions are executed. Raise ``ValueError`` if it is not the manifest's."""
        own = self.control_hz
        if abs(hz - own) > HZ_TOLERANCE * own:
            raise ValueError(f"onnx: the manifest states {own:g} Hz, and the run has {hz:g} Hz. Use its rate")

    def set_reading(self, reading: Observation) -> None:
        """Set the whole reading from which the next actions are computed."""
        self._reading = reading

    def reset(self, seed: int | None = None) -> None:
        """Forget all earlier readings and actions. ``seed`` has no effect."""
        self._last = [0.0] * len(self._manifest.joints)
        self._frames: deque[list[float]] = deque(maxlen=self._manifest.history)
        self._rows_given = 0

    def get_actions_sync(
        self, observation: Mapping[str, float], instruction: str, **_: Any
    ) -> list[dict[str, float]]:
        """Return the next chunk of actions.

        Args:
            observation: Measured position by joint, in the driver's units.
            instruction: Has no effect.

        Raises:
            ValueError: The robot gives no value that the network reads.
        """
        manifest = self._manifest
        positions = [
            observation[joint.name] * factor for joint, factor in zip(manifest.joints, self._factors, strict=True)
        ]
        frame = [value for block in manifest.observation for value in self._values(block, positions)]
        self._frames.extend([frame] * (1 if self._frames else manifest.history))
        rows = self._network.compute([value for each in self._frames for value in each])
        self._last = rows[-1]
        self._rows_given += len(rows)
        return [self._targets(row, positions) for row in rows]

    def _targets(self, row: Sequence[float], positions: Sequence[float]) -> dict[str, float]:
        action, targets = self._manifest.action, {}
        rows = zip(self._manifest.joints, row, positions, self._factors, self._ranges, strict=True)
        for joint, value, position, factor, (low, high) in rows:
            start = position if action.kind is ActionKind.DELTA else joint.offset
            target = (start + value * action.scale / joint.scale) / factor
            # A target that is not a number stays one, so that the robot refuses it.
            targets[joint.name] = low if target < low else high if target > high else target
        return targets

    def _values(self, block: Block, positions: Sequence[float]) -> Sequence[float]:
        joints = self._manifest.joints
        match block:
            case Position():
                rows = zip(joints, positions, strict=True)
                return [(position - joint.offset) * joint.scale for joint, position in rows]
            case Velocity(scale=scale):
                velocity = self._reading.velocity if self._reading is not None else ()
                if not velocity:
                    raise ValueError("onnx: the network reads velocities, and the robot reports none")
                return [
                    velocity[index] * factor * scale
                    for index, factor in zip(self._index, self._factors, strict=True)
                ]
            case LastAction():
                return self._last
            case Gravity():
                roll, pitch = self._sensor(RPY, 3)[:2]
                level = math.cos(pitch)
                return [math.sin(pitch), -level * math.sin(roll), -level * math.cos(roll)]
            case SensorValues(key=key, size=size, scale=scale):
                return [value * scale for value in self._sensor(key, size)]
            case Constant(values=values):
                return values
            case Command():
                return self._command_now()

    def _command_now(self) -> Sequence[float]:
        manifest = self._manifest
        if manifest.ends_s is None or self._rows_given < manifest.ends_s * manifest.control_hz:
            return self._command
        return (*manifest.idle, *self._command[len(manifest.idle) :])

    def _sensor(self, key: str, size: int) -> tuple[float, ...]:
        sensors = self._reading.sensors if self._reading is not None else {}
        values = sensors.get(key, ())
        if len(values) != size:
            has = ", ".join(sorted(sensors))[:200] or "no sensors"
            raise ValueError(f"onnx: the network reads {size} values of {key}, and the robot has {has}")
        return values


__all__ = ["OnnxPolicy"]
