"""Show a simulation in MuJoCo's viewer. The viewer runs in a separate process, which only reads the simulation."""

from __future__ import annotations

import socket
from typing import Any

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.simulation_control import protocol as p
from strands_actors.drivers.common.simulation_control.client import SimulationClient
from strands_actors.drivers.common.simulation_control.scene import View, look

FRAME_S = 1 / 60
SHAPE = (4, 3)
"""Aspect ratio of the window, about."""

ANSWER_S = 10.0


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Run the viewer process. It ends when its window is closed, when the simulation ends, or when the script
    ends."""
    trio.run(_mirror, args["control"], sock)


async def _mirror(control: str, sock: socket.socket) -> None:
    from mujoco import viewer

    client = SimulationClient(control)
    file = (await client.call(p.GetModel(0), p.Model, ANSWER_S)).binary
    model = mujoco.MjModel.from_binary_path("scene.mjb", {"scene.mjb": file})
    data = mujoco.MjData(model)
    window = viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
    with window.lock():
        look(window.cam, model, View(tuple(model.stat.center), model.stat.extent), *SHAPE)
    sock.sendall(b"\x01")  # tells the script that the window is open
    async with trio.open_nursery() as nursery:
        nursery.start_soon(_end_with, sock, nursery.cancel_scope)
        while window.is_running():
            try:
                pose = await client.call(p.GetPose(0), p.Pose, ANSWER_S)
            except WireDown:
                break
            with window.lock():
                data.qpos[:] = pose.qpos
                mujoco.mj_forward(model, data)
            window.sync()
            await trio.sleep(FRAME_S)
        nursery.cancel_scope.cancel()
    window.close()


async def _end_with(sock: socket.socket, scope: trio.CancelScope) -> None:
    """Close the window when the process of the script ends."""
    await trio.lowlevel.wait_readable(sock)
    scope.cancel()
