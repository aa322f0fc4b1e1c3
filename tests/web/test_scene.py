"""The model of a robot for the browser."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trio

from strands_actors.surfaces.cli import run
from strands_actors.surfaces.web.scene import Scenes

OWN = """
<mujoco>
  <asset><mesh name="tooth" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .2"/></asset>
  <worldbody>
    <body name="arm" pos="0 0 .5">
      <joint name="turn" axis="0 0 1" range="-1 1"/>
      <geom type="mesh" mesh="tooth"/>
    </body>
  </worldbody>
  <actuator><position joint="turn"/></actuator>
</mujoco>
"""


def test_a_robot_is_drawn_by_the_users_own_meshes(tmp_path: Path) -> None:
    file = tmp_path / "own.xml"
    file.write_text(OWN)
    data = trio.run(Scenes({"mine": str(file)}).get, "own_arm", "mine")
    length = int.from_bytes(data[:4], "little")
    head: dict[str, Any] = json.loads(data[4 : 4 + length])
    assert [joint["name"] for body in head["bodies"] for joint in body["joints"]] == ["turn"]
    (mesh,) = head["meshes"]
    assert mesh["body"] == "arm"
    points = np.frombuffer(data, "<f4", mesh["points"] * 3, 4 + length + mesh["at"]).reshape(-1, 3)
    assert np.ptp(points, axis=0).max() == pytest.approx(0.2, abs=0.05)


@pytest.mark.parametrize("text", ["mine", "mine=/nowhere.xml", "=x"])
def test_a_model_file_that_does_not_exist_is_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["web", "--port", "0", "--model-file", text]) == 2
    assert "NAME=FILE" in capsys.readouterr().err
