"""``teleop`` without a connected leader."""

from __future__ import annotations

from .command import Command


def test_a_leader_that_is_not_there_is_no_success_and_its_reason_is_told_whole(cli: Command) -> None:
    done = cli.run("teleop", "so101", "--twin", "--from", "so101_leader:/dev/null/arm", "--seconds", "1")
    assert done.returncode == 1, done.stdout + done.stderr
    assert done.stdout == "0 setpoints, 0 frames refused; ended: duration (1 s are over)\n"
    told = done.stderr.splitlines()
    assert told[-1].startswith("the leader is not connected: /dev/null/arm: cannot open")
    assert told[-1].endswith("Check port= and who else has it")
    assert len([line for line in told if line.startswith("idle ")]) <= 3, "a line for each change"
