"""Show a robot in Rerun: in a window of its viewer, or as a recording in a file.

A body is an entity below that of its parent, such as ``world/base/shoulder``, so its transform is the frame in its
parent. Rerun's times are the robot's wall clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from .events import Event, Level
from .model import WORLD, Frame, Mesh, RobotModel
from .sinks import Reading

TIMELINE = "time"
MEMORY = "2GB"
"""The viewer drops the oldest data beyond this, so that it may run for days."""

_LEVELS: Mapping[Level, str] = {Level.INFO: "INFO", Level.WARNING: "WARN", Level.ERROR: "ERROR"}


class RerunSink:
    """A stream to Rerun.

    Args:
        robot: Name of the robot.
        file: The recording to write (``.rrd``). None: open a window of Rerun's viewer, which stays open after the
            view has ended.

    Raises:
        OSError: The file cannot be written, or the viewer cannot be started.
    """

    def __init__(self, robot: str, file: Path | None) -> None:
        self._stream = rr.RecordingStream("strands-actors", send_properties=True)
        self._stream.send_recording_name(robot)
        blueprint = _blueprint()
        try:
            if file is None:
                self._stream.spawn(memory_limit=MEMORY, hide_welcome_screen=True, default_blueprint=blueprint)
            else:
                self._stream.save(file, default_blueprint=blueprint)
        except RuntimeError as error:  # Rerun reports every failure so.
            raise OSError(str(error)) from error
        self._paths: dict[str, str] = {WORLD: WORLD}
        self._meshes: RobotModel | None = None
        self._stream.log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def reading(self, reading: Reading) -> None:
        self._set_time(reading.t)
        self._stream.log("age_s", rr.Scalars(reading.age_s))
        for joint in reading.joints:
            values = {
                f"joints/{joint.name}/measured": joint.measured,
                f"joints/{joint.name}/commanded": joint.commanded,
                f"velocities/{joint.name}": joint.velocity,
            }
            for path, value in values.items():
                if value is not None:
                    self._stream.log(path, rr.Scalars(value))

    def model(self, model: RobotModel) -> None:
        # The meshes are logged with the first frames, which have the parents of the bodies.
        self._meshes = model

    def frames(self, t: float, frames: Sequence[Frame]) -> None:
        self._set_time(t)
        for frame in frames:
            path = self._paths[frame.name] = f"{self._paths[frame.parent]}/{frame.name}"
            w, x, y, z = frame.quat
            self._stream.log(
                path, rr.Transform3D(translation=frame.xyz, quaternion=rr.Quaternion(xyzw=(x, y, z, w)))
            )
        if self._meshes is not None:
            self._log_meshes(self._meshes)
            self._meshes = None

    def event(self, event: Event) -> None:
        self._set_time(event.t)
        self._stream.log(f"events/{event.kind}", rr.TextLog(event.text, level=_LEVELS[event.level]))

    def picture(self, t: float, camera: str, jpeg: bytes) -> None:
        self._set_time(t)
        self._stream.log(f"camera/{camera}", rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))

    def topic(self, t: float, topic: str, values: dict[str, Any]) -> None:
        """Plot the numbers of a sensor. ``presence`` and ``health`` have little to plot, and their changes are
        events."""
        self._set_time(t)
        for name, value in values.items():
            numbers = value if isinstance(value, list) else [value]
            are_numbers = all(isinstance(each, int | float) and not isinstance(each, bool) for each in numbers)
            if numbers and are_numbers and name not in _TIMES:
                self._stream.log(f"{topic}/{name}", rr.Scalars(numbers))

    def close(self) -> None:
        self._stream.flush()
        self._stream.disconnect()

    def _set_time(self, t: float) -> None:
        self._stream.set_time(TIMELINE, timestamp=t)

    def _log_meshes(self, model: RobotModel) -> None:
        for number, mesh in enumerate(model.meshes()):
            shape = rr.Mesh3D(
                vertex_positions=mesh.points,
                triangle_indices=mesh.faces,
                vertex_normals=_normals(mesh),
                albedo_factor=[*mesh.rgba],
            )
            self._stream.log(f"{self._paths[mesh.body]}/mesh_{number}", shape, static=True)


def _normals(mesh: Mesh) -> NDArray[np.float64]:
    """Return the normal at each corner: the mean of those of its triangles, by their area. Without normals, Rerun
    draws a surface without shading."""
    first, second, third = (mesh.points[mesh.faces[:, corner]] for corner in range(3))
    of_faces = np.cross(second - first, third - first)
    normals = np.zeros(mesh.points.shape)
    for corner in range(3):
        np.add.at(normals, mesh.faces[:, corner], of_faces)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    scaled: NDArray[np.float64] = normals / np.where(lengths > 0, lengths, 1.0)
    return scaled


def _blueprint() -> rrb.Blueprint:
    """Return the arrangement of the window, with model and events beside joints and cameras."""
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(name="Model", origin=WORLD),
                rrb.TextLogView(name="Events", origin="events"),
                row_shares=[3, 1],
            ),
            rrb.Vertical(
                rrb.TimeSeriesView(name="Joints", origin="joints"),
                rrb.TimeSeriesView(name="Age of the reading (s)", origin="age_s"),
                rrb.Spatial2DView(name="Cameras", origin="camera"),
                row_shares=[3, 1, 2],
            ),
        ),
        collapse_panels=True,
    )


_TIMES = ("t", "timestamp")
"""Fields of telemetry that have the time of the sample."""
