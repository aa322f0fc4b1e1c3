"""Make the picture of the live view: Rerun's own viewer, which shows a recording of the twin of an SO-101.

It needs ``pip install 'strands-actors[rerun]'`` and a driver of Vulkan: a graphics card, or the program of Debian's
package mesa-vulkan-drivers. No display is needed.
"""

from __future__ import annotations

import contextlib
import importlib.util
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

from strands_actors import Robot

ROBOT = "so101"
SECONDS = 11.0
REFUSED_S = 7.0
"""When a target is sent that the robot refuses."""
SIZE = (1400, 800)
BAR = 36
"""Height of the viewer's menu bar, and of the bar with the time. They are cut off."""
COLOURS = 128
PORT = "9977"
DRAWN_S = 8.0
"""How long the viewer needs to read the recording, in seconds."""
PATIENCE_S = 60.0

_VIEW = "from strands_actors.surfaces.cli import main; main()"


def make(path: Path) -> None:
    """Move a twin, record it with ``strands-actors view``, and write a picture of Rerun's viewer.

    Raises:
        RuntimeError: Rerun is not installed, or its viewer cannot draw here.
    """
    if importlib.util.find_spec("rerun") is None:
        raise RuntimeError("this picture needs Rerun: pip install 'strands-actors[rerun]'")
    with tempfile.TemporaryDirectory() as folder:
        recording, drawn = Path(folder) / "run.rrd", Path(folder) / "drawn.png"
        _record(recording)
        _draw(recording, drawn)
        with Image.open(drawn) as picture:
            width, height = picture.size
            cut = picture.convert("RGB").crop((0, BAR, width, height - BAR))
            cut.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


def _record(recording: Path) -> None:
    """Write a recording of a twin that moves, refuses a target, and is stopped."""
    with contextlib.ExitStack() as stack:
        run = stack.enter_context(tempfile.TemporaryDirectory(prefix="sa-"))
        for name, value in {"STRANDS_ACTORS_RUN": run, "STRANDS_ACTORS_DATA": f"{run}/data"}.items():
            stack.callback(os.environ.__setitem__, name, os.environ.get(name, ""))
            os.environ[name] = value
        arm = stack.enter_context(Robot(ROBOT, mode="real", transport="twin", cameras={"wrist": {}}))
        if (problem := arm.connect_eagerly()) is not None:
            raise RuntimeError(problem)
        arguments = ["view", ROBOT, "--rerun", "--save", str(recording)]
        view = stack.enter_context(
            subprocess.Popen([sys.executable, "-c", _VIEW, *arguments], stdout=subprocess.PIPE)
        )
        stack.callback(view.kill)
        assert view.stdout is not None
        view.stdout.readline()
        began, is_refused = time.monotonic(), False
        while (passed_s := time.monotonic() - began) < SECONDS:
            if passed_s > REFUSED_S and not is_refused:
                is_refused = arm.send_action({"shoulder_pan": 400.0})["status"] == "error"
            arm.send_action(_pose(passed_s))
            time.sleep(0.05)
        arm.stop()
        time.sleep(3.5)  # while it is lowered
        view.terminate()
        if view.wait(PATIENCE_S) != 0:
            raise RuntimeError("the view has failed")


def _pose(t: float) -> dict[str, float]:
    return {
        "shoulder_pan": 35 * math.sin(t),
        "shoulder_lift": -40 + 20 * math.sin(1.1 * t),
        "elbow_flex": 40 + 25 * math.sin(1.3 * t),
        "wrist_flex": 20 * math.sin(t),
        "gripper": 50 + 40 * math.sin(t),
    }


def _draw(recording: Path, drawn: Path) -> None:
    """Write a picture of Rerun's viewer. It runs without a window."""
    from rerun.experimental import ViewerClient

    size = "x".join(map(str, SIZE))
    options = ["--headless", "--renderer", "vulkan", "--window-size", size, "--bind", "127.0.0.1", "--port", PORT]
    # The module ``rerun`` starts the viewer as a child, so the whole session has to be ended.
    viewer = subprocess.Popen(
        [sys.executable, "-m", "rerun", *options, str(recording)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        time.sleep(DRAWN_S)
        if viewer.poll() is not None:
            raise RuntimeError("Rerun's viewer cannot draw here. Install a driver of Vulkan: mesa-vulkan-drivers")
        ViewerClient(f"rerun+http://127.0.0.1:{PORT}/proxy").save_screenshot(str(drawn))
    finally:
        with contextlib.suppress(ProcessLookupError):  # The viewer has ended.
            os.killpg(viewer.pid, signal.SIGKILL)
        viewer.wait()
