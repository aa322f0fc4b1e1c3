"""Simulate faults of the whole machine in one process. A signal begins each fault.

Python imports this module at its start when its folder is in the path.

* After ``FULL_TABLE`` the process gets no new file any more, as if the system's table of open files were
  full (ENFILE). The real table belongs to the whole machine. So a kernel filter refuses instead, in all
  threads of this process and in the processes that it starts. Closing files does not help: another process
  has taken them.
* Each signal of ``CLOCK_STEPS_S`` sets the wall clock of Python in this process.
"""

from __future__ import annotations

import ctypes
import errno
import os
import platform
import signal
import struct
import time

_X86_64 = (2, 22, 41, 43, 53, 85, 213, 253, 257, 282, 283, 284, 288, 289, 290, 291, 293, 294, 319, 434, 437)
_AARCH64 = (19, 20, 26, 56, 59, 74, 85, 198, 199, 202, 242, 279, 434, 437)
OPENING = {"x86_64": _X86_64, "aarch64": _AARCH64}
"""Numbers of the system calls that create a file: open, socket, accept, pipe, eventfd, epoll_create,
timerfd_create, signalfd, memfd_create, inotify_init, pidfd_open.
"""
_SECCOMP = {"x86_64": 317, "aarch64": 277}
_SET_MODE_FILTER, _ALL_THREADS = 1, 1
_NO_NEW_PRIVILEGES = 38  # prctl(2)
FILTERED = "Seccomp:\t2"
"""A line of ``/proc/<pid>/status`` after the filter is installed."""
_LOAD, _JUMP_IF_EQUAL, _RETURN = 0x20, 0x15, 0x06
_ALLOW, _FAIL = 0x7FFF0000, 0x00050000
FULL_TABLE = signal.SIGRTMIN + 5
CLOCK_STEPS_S = {signal.SIGRTMIN + 6: 3600, signal.SIGRTMIN + 7: -3600}
"""The signals that set the clock, and by how many seconds it then differs from the real one. A process that
has set its clock ignores the signal from then on, which shows in ``/proc/<pid>/status``."""
# No process of a robot uses these signals otherwise.
_true_time, _true_time_ns = time.time, time.time_ns


def refuse_files(*_: object) -> None:
    machine = platform.machine()
    numbers = OPENING[machine]
    steps = [(_LOAD, 0, 0, 0)]
    steps += [(_JUMP_IF_EQUAL, len(numbers) - index, 0, number) for index, number in enumerate(numbers)]
    steps += [(_RETURN, 0, 0, _ALLOW), (_RETURN, 0, 0, _FAIL | errno.ENFILE)]
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *step) for step in steps))
    program = ctypes.create_string_buffer(struct.pack("@HP", len(steps), ctypes.addressof(code)))
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    if libc.syscall(_SECCOMP[machine], _SET_MODE_FILTER, _ALL_THREADS, program):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def set_clock(number: int, _: object) -> None:
    step_s = CLOCK_STEPS_S[number]
    time.time = lambda: _true_time() + step_s
    time.time_ns = lambda: _true_time_ns() + step_s * 1_000_000_000
    signal.signal(number, signal.SIG_IGN)


if __name__ == "sitecustomize":
    signal.signal(FULL_TABLE, refuse_files)
    for each in CLOCK_STEPS_S:
        signal.signal(each, set_clock)
