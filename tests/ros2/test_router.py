"""A robot of a type that is not known here, and a router that restarts."""

from __future__ import annotations

import contextlib

import trio

from strands_actors.kernel.channels.ros2.names import ros_name
from strands_actors.surfaces.ros2.bridge import Options, open_bridge
from tests.answers import until
from tests.mesh.world import mesh, robot_on_mesh, run
from tests.ports import free_port

from .peer import Program, router


def services_of(program: Program, robot: str) -> set[str]:
    """Wait until the robot is on the graph, and return the names of all services."""
    until(lambda: f"/{robot}/estop" in program.names("SS"), "the robot appears")
    return program.names("SS")


def test_an_unknown_robot_can_be_stopped_also_after_a_restart_of_the_router() -> None:
    lines: list[str] = []

    def printed(part: str) -> None:
        until(lambda: any(part in line for line in lines), f"{part}: {lines}")

    async def test() -> None:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        in_thread = trio.to_thread.run_sync
        with contextlib.ExitStack() as first:
            first.enter_context(router(endpoint))
            program = first.enter_context(Program(endpoint))
            options = Options(router=endpoint)
            async with (
                robot_on_mesh() as (robot_name, _, _),
                mesh() as client,
                open_bridge(client, options, lines.append),
            ):
                robot = ros_name(robot_name)
                services = await in_thread(services_of, program, robot)
                assert services == {f"/{robot}/stop", f"/{robot}/estop"}  # without --allow-motion
                assert f"/{robot}/joint_states" not in await in_thread(program.names, "MP")
                await in_thread(printed, "its joints are not shown")
                await in_thread(first.close)
                await in_thread(printed, "does not answer")
                with router(endpoint), Program(endpoint) as later:
                    await in_thread(services_of, later, robot)
                    success, message = await in_thread(later.trigger, f"/{robot}/stop")
                    assert success and "a confirmed" in message, message

    run(test)
