"""Make ``demo.gif``: the twin of an SO-101 beside the plot of its joints, while its processes are killed."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.kernel.clock import NS
from strands_actors.simulation.gif import write_gif
from strands_actors.surfaces.cli.demo.watch import Sample

from .camera import Direction, frame, visible_points
from .light import Studio
from .watching import Seen, watch_demo

WIDTH, HEIGHT = 860, 380
TWIN = 380
"""Width of the part with the twin."""
FPS = 12
SAMPLES = 6
BEFORE_S, AFTER_S = 1.6, 1.8
"""How long the motion is shown before a fault, and after the arm moves again."""

SHOWN = ("shoulder_lift", "elbow_flex", "gripper")
COLOURS = ("#1f6fb4", "#2a9d5c", "#b8621b")
INK, PALE, FAULT, SAFE = "#20262e", "#8a929c", "#c1121f", "#fbe3ae"
PAPER = "#ffffff"
FINE = 2
"""The plot is drawn so many times larger, and then reduced, so that its lines are smooth."""


def make(path: Path) -> None:
    """Run the demo, and write the animation."""
    write_gif(path, draw(watch_demo()), FPS)


def draw(seen: Seen) -> list[NDArray[np.uint8]]:
    """Return the pictures of the animation, each of shape (height, width, 3)."""
    times = frame_times(seen)
    studio = Studio(seen.scene, TWIN, HEIGHT, SAMPLES)
    try:
        eye = _eye(studio.model, seen.poses)
        plot = Plot(seen, times[0], times[-1])
        pictures = []
        for t_ns in times:
            twin = studio.shoot(_at(seen.poses, t_ns), eye)
            pictures.append(np.concatenate([twin, plot.draw(t_ns)], axis=1))
    finally:
        studio.close()
    return pictures


def frame_times(seen: Seen) -> list[int]:
    """Return the times of the pictures: from shortly before the first fault until the arm moves again after the
    last one."""
    first, last = seen.outcomes[0], seen.outcomes[-1]
    assert last.resumed_ns is not None
    moves = next((sample.t_ns for sample in seen.targets if sample.t_ns > last.resumed_ns), last.resumed_ns)
    began, ended = first.struck_ns - BEFORE_S * NS, min(moves + AFTER_S * NS, seen.poses[-1].t_ns)
    return [int(began + index * NS / FPS) for index in range(int((ended - began) / NS * FPS))]


def _at(samples: Sequence[Sample], t_ns: int) -> tuple[float, ...]:
    """Return the values of the newest sample at a time."""
    index = bisect_right(samples, t_ns, key=lambda sample: sample.t_ns) - 1
    return samples[max(0, index)].values


def _eye(model: Any, poses: Sequence[Sample]) -> Any:
    """Return a camera that has the arm in its picture in every pose."""
    data = mujoco.MjData(model)
    clouds = []
    for pose in poses[::10]:
        data.qpos[:] = pose.values
        mujoco.mj_kinematics(model, data)
        clouds.append(visible_points(model, data)[::7])
    return frame(np.concatenate(clouds), Direction(118.0, -18.0), TWIN / HEIGHT, 0.9)


class Plot:
    """The joints over time, and what happens at the moment."""

    def __init__(self, seen: Seen, began_ns: int, ended_ns: int) -> None:
        self._seen = seen
        self._began_ns, self._ended_ns = began_ns, ended_ns
        self._width = WIDTH - TWIN
        self._left, self._right = 20, self._width - 20
        self._fonts = {
            (size, bold): ImageFont.truetype(_font(bold), size * FINE)
            for size in (11, 12, 15)
            for bold in (False, True)
        }
        rows = [seen.axes.index(axis) for axis in SHOWN]
        self._rows = list(zip(rows, SHOWN, COLOURS, strict=True))
        self._spans = {row: self._span(row) for row in rows}

    def draw(self, t_ns: int) -> NDArray[np.uint8]:
        """Return the plot at a time, of shape (height, width, 3)."""
        image = Image.new("RGB", (self._width * FINE, HEIGHT * FINE), PAPER)
        pen = ImageDraw.Draw(image)
        title, colour, detail = self._caption(t_ns)
        self._text(pen, self._left, 16, title, 15, colour, bold=True)
        self._text(pen, self._left, 38, detail, 12, INK if colour == FAULT else PALE)
        top, height = 70, 82
        for number, (row, axis, curve) in enumerate(self._rows):
            self._panel(pen, row, axis, curve, top + number * (height + 12), height, t_ns)
        self._legend(pen, HEIGHT - 24)
        small = image.resize((self._width, HEIGHT), Image.Resampling.LANCZOS)
        return np.asarray(small)

    def _panel(self, pen: Any, row: int, axis: str, colour: str, top: int, height: int, t_ns: int) -> None:
        bottom = top + height
        for outcome in self._seen.outcomes:
            if outcome.safe_ns is not None and outcome.safe_ns <= t_ns:
                until = min(t_ns, outcome.resumed_ns or t_ns)
                box = (self._x(outcome.safe_ns), top, self._x(until), bottom)
                pen.rectangle([value * FINE for value in box], fill=SAFE)
        pen.line(
            [(self._left * FINE, bottom * FINE), (self._right * FINE, bottom * FINE)], fill="#d5dae0", width=FINE
        )
        low, high = self._spans[row]

        def place(sample: Sample) -> tuple[float, float]:
            part = (sample.values[row] - low) / (high - low)
            return self._x(sample.t_ns) * FINE, (bottom - 6 - part * (height - 22)) * FINE

        for samples, ink, width in ((self._seen.targets, PALE, 1), (self._seen.positions, colour, 2)):
            for piece in _pieces([s for s in samples if self._began_ns <= s.t_ns <= t_ns]):
                pen.line([place(sample) for sample in piece], fill=ink, width=width * FINE, joint="curve")
        for outcome in self._seen.outcomes:
            if outcome.struck_ns <= t_ns:
                x = self._x(outcome.struck_ns) * FINE
                pen.line([(x, top * FINE), (x, bottom * FINE)], fill=FAULT, width=FINE + 1)
        self._text(pen, self._left, top - 4, axis, 11, colour, bold=True)

    def _legend(self, pen: Any, y: int) -> None:
        middle = (y + 7) * FINE
        for x, ink, width, text in (
            (self._left, COLOURS[0], 2, "measured"),
            (self._left + 110, PALE, 1, "setpoint"),
            (self._left + 215, FAULT, 2, "a process is killed"),
            (self._left + 365, SAFE, 9, "stopped"),
        ):
            pen.line([(x * FINE, middle), ((x + 18) * FINE, middle)], fill=ink, width=width * FINE)
            self._text(pen, x + 24, y, text, 11, PALE)

    def _caption(self, t_ns: int) -> tuple[str, str, str]:
        """Return what happens at a time: a title with its colour, and a second line."""
        for outcome in reversed(self._seen.outcomes):
            if t_ns < outcome.struck_ns:
                continue
            moves = next((s.t_ns for s in self._seen.targets if s.t_ns > (outcome.resumed_ns or t_ns)), t_ns + 1)
            if outcome.resumed_ns is None or t_ns < outcome.resumed_ns:
                title = f"{outcome.signal} to the {outcome.victim} process"
                return (
                    title,
                    FAULT,
                    f"{outcome.safe_state} after {outcome.safe_after_ms or 0:.1f} ms, and no setpoint follows",
                )
            if t_ns < moves:
                return "resume()", INK, "The arm is energised where it is."
            return "A new policy moves the arm", INK, "The process was started again."
        return "A policy moves the arm", INK, "Setpoints at 50 Hz, each through the gate."

    def _text(self, pen: Any, x: int, y: int, text: str, size: int, ink: str, bold: bool = False) -> None:
        pen.text((x * FINE, y * FINE), text, font=self._fonts[size, bold], fill=ink)

    def _x(self, t_ns: float) -> float:
        part = (t_ns - self._began_ns) / (self._ended_ns - self._began_ns)
        return self._left + part * (self._right - self._left)

    def _span(self, row: int) -> tuple[float, float]:
        values = [sample.values[row] for sample in self._seen.positions if sample.t_ns >= self._began_ns]
        return min(values), max(values) + 1e-9


GAP_S = 0.25
"""If readings are further apart than this, in seconds, the line has a gap, because the position is unknown."""


def _pieces(samples: Sequence[Sample]) -> list[list[Sample]]:
    """Return the samples in pieces without a gap, each of two samples or more."""
    pieces: list[list[Sample]] = [[]]
    for sample in samples:
        if pieces[-1] and sample.t_ns - pieces[-1][-1].t_ns > GAP_S * NS:
            pieces.append([])
        pieces[-1].append(sample)
    return [piece for piece in pieces if len(piece) > 1]


def _font(bold: bool) -> str:
    properties = font_manager.FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal")
    return font_manager.findfont(properties)
