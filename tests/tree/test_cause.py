"""The cause in the status is that of the present state. In virtual time."""

from __future__ import annotations

import trio

from strands_actors.caller.handle.envelopes import status as status_json
from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Accepted, Resume, Resumed, Stop
from strands_actors.testing import open_inline_tree, run_virtual
from strands_actors.testing.inline import InlineTree

from .writer import Writer, armed


async def causes(tree: InlineTree) -> tuple[str, str | None, str | None]:
    """Return the state, its cause and the cause of the last stop, as ``get_status`` shows them, and check that the
    root has the same cause."""
    status = await tree.status()
    assert tree.keeper.state.cause == status.cause
    shown = status_json("fake", "fake", tree.driver, "", status, {})
    return shown["state"], shown["cause"], shown["last_stop_cause"]


def test_an_armed_robot_shows_no_cause_and_that_of_its_last_stop() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            assert await causes(tree) == ("disarmed", None, None)
            writer = await armed(tree)
            assert await causes(tree) == ("armed", None, None)
            assert isinstance(await writer.send(ttl_s=0.1, a=1.0), Accepted)
            await tree.until("holding")
            assert await causes(tree) == ("holding", "the setpoint expired", "the setpoint expired")
            await writer.read_epoch()
            assert isinstance(await writer.send(latched=True, a=1.0), Accepted)
            assert await causes(tree) == ("armed", None, "the setpoint expired")
            await tree.gate.ask(Stop(Reason.STOP, "a person"), 1.0)
            assert await causes(tree) == ("disarmed", "stop by a person", "stop by a person")
            assert isinstance(await tree.gate.ask(Resume(), 1.0), Resumed)
            assert await causes(tree) == ("armed", None, "stop by a person")

    run_virtual(run)


def test_a_command_from_before_a_hold_is_refused_with_its_cause_although_the_robot_is_armed_again() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(ttl_s=0.1, a=1.0), Accepted)
            await tree.until("holding")
            late = Writer(tree)
            late.lease = writer.lease
            await writer.read_epoch()
            assert isinstance(await writer.send(latched=True, a=1.0), Accepted)
            refused = await late.send(a=2.0)
            assert isinstance(refused, Refused) and refused.code == "stale_epoch"
            assert "(the setpoint expired)" in refused.text

    run_virtual(run)


def test_a_wire_that_was_restarted_keeps_the_cause_for_after_its_resume() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.wire._scope.cancel()
            await tree.until("disarmed")
            _, cause, _ = await causes(tree)
            assert cause is not None and "the wire group ended" in cause
            await trio.sleep(0.1)
            assert isinstance(await tree.gate.ask(Resume(), 1.0), Resumed)
            assert await causes(tree) == ("armed", None, cause)

    run_virtual(run)
