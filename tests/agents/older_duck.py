"""Write the manifest for a network that mjlab has exported for a Microduck.

``python -m tests.agents.older_duck NETWORK.onnx FOLDER`` writes an ONNX policy into the folder. It is for networks
of 51 numbers, as apirrone/microduck_runtime publishes them: without the ten numbers for head and body that newer
ones read. mjlab writes the names of the joints and their home pose into the network.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import onnxruntime

BLOCKS = {
    "base_ang_vel": {"block": "sensor", "key": "gyro_rad_s", "size": 3},
    "projected_gravity": {"block": "gravity"},
    "joint_pos": {"block": "position"},
    "joint_vel": {"block": "velocity"},
    "actions": {"block": "last_action"},
    "command": {"block": "command", "values": [0.0, 0.0, 0.0]},
}


def write(network: Path, folder: Path) -> None:
    """Copy the network into the folder, and write its manifest."""
    stated = onnxruntime.InferenceSession(network.read_bytes()).get_modelmeta().custom_metadata_map
    names, homes = stated["joint_names"].split(","), stated["default_joint_pos"].split(",")
    manifest = {
        "format": "strands-actors-onnx",
        "version": 1,
        "file": "policy.onnx",
        "control_hz": 50,
        "joints": [
            {"name": name, "unit": "rad", "offset": float(home)} for name, home in zip(names, homes, strict=True)
        ],
        "observation": [BLOCKS[name] for name in stated["observation_names"].split(",")],
        "action": {"kind": "offset", "scale": float(stated["action_scale"]), "clip": True},
    }
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(network, folder / "policy.onnx")
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n")


if __name__ == "__main__":
    write(Path(sys.argv[1]), Path(sys.argv[2]))
