"""Heartbeats that two processes write to a shared page."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

from strands_actors.kernel.health.heartbeat import Heartbeat, Word, new_page, pair, words_of
from tests.answers import until

BEATING = """
import sys, time
from strands_actors.kernel.health.heartbeat import Heartbeat, words_of
heartbeat = Heartbeat(words_of(int(sys.argv[1])), 1, 0)
while True:
    heartbeat.beat(time.monotonic_ns())
    time.sleep(0.001)
"""


def test_each_process_receives_the_others_heartbeat_and_not_its_own() -> None:
    one, other = pair()
    assert one.last_received_ns == other.last_received_ns == 0
    one.beat(7)
    assert (one.last_received_ns, other.last_received_ns) == (0, 7)
    other.beat(2**62)
    assert (one.last_received_ns, other.last_received_ns) == (2**62, 7)
    one.forget()
    assert (one.last_received_ns, other.last_received_ns) == (0, 7)


def test_a_page_outlives_its_descriptor_and_starts_without_a_heartbeat() -> None:
    fd = new_page()
    one, other = Heartbeat(words_of(fd), 0, 1), Heartbeat(words_of(fd), 1, 0)
    os.close(fd)
    assert one.last_received_ns == other.last_received_ns == 0
    other.beat(11)
    assert one.last_received_ns == 11


def test_the_words_of_a_page_do_not_overlap() -> None:
    fd = new_page()
    words = words_of(fd)
    os.close(fd)
    places = [Word(words, place) for place in range(8)]
    for number, place in enumerate(places):
        place.set(-number)
    assert [place.get() for place in places] == [-number for number in range(8)]


def test_heartbeats_of_a_process_end_when_it_is_stopped_and_continue_afterwards() -> None:
    fd = new_page()
    heartbeat = Heartbeat(words_of(fd), 0, 1)
    began_ns = time.monotonic_ns()
    with subprocess.Popen([sys.executable, "-c", BEATING, str(fd)], pass_fds=(fd,)) as child:
        try:
            until(lambda: heartbeat.last_received_ns > began_ns, "heartbeats arrive")
            child.send_signal(signal.SIGSTOP)
            os.waitid(os.P_PID, child.pid, os.WSTOPPED)
            last_ns = heartbeat.last_received_ns
            time.sleep(0.05)
            assert heartbeat.last_received_ns == last_ns <= time.monotonic_ns()
            child.send_signal(signal.SIGCONT)
            until(lambda: heartbeat.last_received_ns > last_ns, "heartbeats arrive again")
        finally:
            child.kill()
            os.close(fd)
