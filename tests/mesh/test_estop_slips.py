"""An e-stop is sent and answered even if its other arguments or fields are invalid."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors import MeshConfig, broadcast, estop
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.surfaces.mesh import estop_button, get_peers, resume, tell
from strands_actors.surfaces.mesh.config import ENVIRONMENT
from strands_actors.surfaces.mesh.outcome import outcome_of
from strands_actors.surfaces.mesh.signing import patience_s, program, signed

from .world import Samples, mesh, raw, robot_on_mesh, run

NAN = float("nan")
LONG = "x" * 300


class Mute:
    def __str__(self) -> str:
        raise RuntimeError("no words")


def test_saf_007_an_estop_is_sent_despite_invalid_arguments() -> None:
    slips: list[dict[str, Any]] = [{"within_s": value} for value in (0, 0.001, -1, NAN, None, "x", 10**400)]
    slips += [{"by": value} for value in (None, 5, LONG, b"raw", "\udc80", Mute())]

    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _):
            for slip in slips:
                (outcome,) = await trio.to_thread.run_sync(partial(estop, **slip))
                assert (outcome.robot, outcome.outcome, outcome.locked) == (robot, "safe", True), slip
                assert (await tree.status()).locked_by, slip
                async with mesh() as client:
                    assert not isinstance(await client.resume(robot, LONG), Refused)

    run(test)


@pytest.mark.parametrize("by", [LONG, 5, None])
def test_saf_007_the_button_sends_with_any_name_of_the_presser(by: Any) -> None:
    def press() -> list[Any]:
        with estop_button(by=by) as button:
            return button()

    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _):
            (outcome,) = await trio.to_thread.run_sync(press)
            assert (outcome.robot, outcome.outcome, outcome.locked) == (robot, "safe", True)
            assert (await tree.status()).locked_by == (
                program() if by is None else LONG[:256] if by == LONG else "5"
            )

    run(test)


def unusable(directory: Path) -> list[tuple[Any, str, str]]:
    """Return unusable values of ``mesh=``, each with the robots that were not looked for and the reason."""
    (directory / "words.toml").write_text("listen = tcp")
    others, odd = "the robots of other hosts", "tcp/127.0.0.1:1#a;b?"
    return [
        (str(directory / "no.toml"), others, "no.toml cannot be read: No such file"),
        (directory / "words.toml", others, "words.toml: "),
        (MeshConfig(connect="tls/arm.example:7447"), others, "needs certificates"),
        (MeshConfig(connect="tls/127.0.0.1:1", tls="keys"), others, "tls is 'keys'. Give TLS("),  # type: ignore[arg-type]
        (5, others, "mesh is 5. Give MeshConfig(...), or the path of a TOML file"),
        (True, others, "mesh is True. Give"),
        ({}, others, "mesh is {}. Give"),
        (MeshConfig(connect=odd, insecure=True), odd, f"mesh: {odd}: "),  # zenoh cannot read it
    ]


def test_saf_007_a_mesh_that_cannot_be_used_keeps_no_stop_from_the_robots_of_this_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def press(given: Any) -> list[Any]:
        with estop_button(mesh=given) as button:
            return button()

    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:

            async def stopped(outcomes: list[Any], who: str, why: str) -> None:
                near, far = outcomes
                assert (near.robot, near.outcome, near.locked) == (robot, "safe", True), outcomes
                assert (far.robot, far.outcome) == (who, "unreachable") and why in far.detail, outcomes
                assert (await tree.status()).locked_by
                assert not isinstance(await client.resume(robot), Refused)

            for given, who, why in unusable(tmp_path):
                await stopped(await trio.to_thread.run_sync(partial(estop, mesh=given)), who, why)
                await stopped(await trio.to_thread.run_sync(press, given), who, why)
                assert f"estop_button: {who}: " in caplog.text and why in caplog.text
                caplog.clear()
                near, far = await trio.to_thread.run_sync(partial(broadcast, "stop", mesh=given))
                assert near["responder_id"] == robot and near["result"]["outcome"] == "safe"
                assert far["responder_id"] == who and why in far["error"]
                assert (await tree.status()).mode == "disarmed"
                assert not isinstance(await client.resume(robot), Refused)
                with pytest.raises(ValueError) as refused:  # a read with this mesh raises an error
                    await trio.to_thread.run_sync(partial(get_peers, mesh=given))
                assert why in str(refused.value)
            monkeypatch.setenv(ENVIRONMENT, str(tmp_path / "no.toml"))
            await stopped(
                await trio.to_thread.run_sync(estop), "the robots of other hosts", "no.toml cannot be read"
            )

    with caplog.at_level(logging.WARNING, "strands_actors"):
        run(test)


@pytest.mark.parametrize(
    ("verb", "message"),
    [
        (lambda: tell(["so101"], "wave"), "tell: the robot is ['so101']. Give the name of a robot, as text"),  # type: ignore[arg-type]
        (lambda: tell(5, "wave"), "tell: the robot is 5. Give the name of a robot"),  # type: ignore[arg-type]
        (lambda: resume(["so101"]), "resume: the robot is ['so101']. Give the name of a robot"),  # type: ignore[arg-type]
        (
            lambda: tell("so101", "wave", polcy_provider="mock"),
            "there is no option 'polcy_provider' ('policy_provider'?). Use policy_provider, policy_host, "
            "policy_port, duration, n_steps, control_frequency",
        ),
        (lambda: tell("so101", "wave", clock="x"), "there is no option 'clock'"),
    ],
)
def test_an_unknown_robot_or_option_is_refused_with_the_known_ones(verb: Callable[[], Any], message: str) -> None:
    with pytest.raises(TypeError) as refused:
        verb()
    assert message in str(refused.value)


def test_a_mesh_may_be_the_path_of_its_file(tmp_path: Path) -> None:
    file = tmp_path / "mesh.toml"
    file.write_text('connect = "tcp/127.0.0.1:1"\ninsecure = true\n')
    for given in (file, str(file)):
        (outcome,) = estop(mesh=given)
        assert (outcome.robot, outcome.detail) == (
            "tcp/127.0.0.1:1",
            "there is no connection to this endpoint",
        )


@pytest.mark.parametrize("order", [{"by": LONG}, {"by": 7}, {"by": None}, {"target_id": 3}], ids=str)
def test_saf_007_the_robot_answers_an_estop_with_invalid_fields(order: dict[str, Any]) -> None:
    """The order comes from a third-party program, with fields that our own program would not send."""

    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            answers = Samples(client, f"strands/their-button/response/{robot}/*")
            await trio.sleep(0.1)
            envelope = {"sender_id": "their-button", "turn_id": "1", **order}
            await raw(client, robot, json.dumps(envelope).encode(), mesh_json.ESTOP_KEY)
            (reply, *_) = await answers.wait()
            assert reply["result"]["outcome"] == "safe"
            assert (await tree.status()).locked_by == (LONG[:256] if order.get("by") == LONG else "their-button")

    run(test)


def test_an_estop_for_one_robot_by_any_sender_leaves_the_others() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            envelope = {"sender_id": "their-button", "turn_id": "1", "target_id": "another", "by": LONG}
            await raw(client, robot, json.dumps(envelope).encode(), mesh_json.ESTOP_KEY)
            await trio.sleep(0.3)
            assert (await tree.status()).mode == "armed"

    run(test)


@pytest.mark.parametrize(
    ("given", "waited_s"), [(0, 0.25), (-1.0, 0.25), (NAN, 0.25), (None, 0.25), ("x", 0.25), (3, 3.0), ("2", 2.0)]
)
def test_the_timeout_of_an_estop_is_limited_from_below(given: Any, waited_s: float) -> None:
    assert patience_s(given) == waited_s


@pytest.mark.parametrize(
    ("argument", "name"),
    [
        ("/home/me/wave.py", "wave.py"),
        ("/x/strands_demo/__main__.py", "strands_demo"),
        ("-c", "python"),
        ("", "python"),
    ],
)
def test_a_program_is_named_as_people_know_it(argument: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", [argument])
    assert signed(None) == signed("") == f"a program ({name}, process {os.getpid()})"
    assert signed("the button\n") == "the button\\n"


@pytest.mark.parametrize("answer", [{"motors": 3}, {"took_ms": "soon"}, {"outcome": "safe", "took_ms": NAN}])
def test_an_answer_that_makes_no_sense_is_not_safe(answer: dict[str, Any]) -> None:
    assert outcome_of("so101", answer).outcome == "unconfirmed"
