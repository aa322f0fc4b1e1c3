"""What a process that runs code of others may use: memory, processors, and whose name.

They are put on by the process itself, before that code is loaded, and cannot be taken off by it
again (a user who is not root cannot raise a limit or change its user). Processors can: they keep a
policy that computes from the others, not one that means harm.
"""

from __future__ import annotations

import os
import pwd
import resource
from collections.abc import Mapping
from typing import Annotated, Any

import msgspec

_KILL, _SETGID, _SETUID = 5, 6, 7  # capabilities, as Linux numbers them


class PolicyLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Of each process of a named policy. ``memory_mb``: its address space, so a library that
    reserves much needs more than it uses. ``cpu_s``: seconds of computing, all its threads
    together; then it is killed. ``processors``: how many of the machine's it runs on. ``user``: as
    whom it runs."""

    memory_mb: Annotated[int, msgspec.Meta(ge=64)] | None = None
    cpu_s: Annotated[int, msgspec.Meta(ge=1)] | None = None
    processors: Annotated[int, msgspec.Meta(ge=1)] | None = None
    user: str = ""

    def check(self) -> None:
        """Raise ``ValueError`` for what this system has not: such a user, or one whom we can
        become."""
        if self.processors is not None and not hasattr(os, "sched_setaffinity"):
            raise ValueError("policy_limits: processors can be limited on Linux alone. leave that out")
        if not self.user:
            return
        try:
            uid = pwd.getpwnam(self.user).pw_uid
        except KeyError:
            raise ValueError(f"policy_limits: this machine has no user {self.user!r}") from None
        if uid != os.getuid() and not _may_be_others():
            raise ValueError(
                f"policy_limits: only root can run a policy as {self.user!r}. Run this program as root, "
                "or with the capabilities CAP_SETUID, CAP_SETGID and CAP_KILL"
            )

    def apply(self) -> None:
        """Put them on this process, for good. Raise ``OSError``, ``ValueError``."""
        if self.processors is not None:
            here = sorted(os.sched_getaffinity(0))[-self.processors :]  # the first have the most to do
            for thread in os.listdir("/proc/self/task"):
                os.sched_setaffinity(int(thread), here)
        if self.cpu_s is not None:
            resource.setrlimit(resource.RLIMIT_CPU, (self.cpu_s, self.cpu_s))
        if self.memory_mb is not None:
            most = self.memory_mb << 20
            resource.setrlimit(resource.RLIMIT_AS, (most, most))
        if self.user:
            self._become()

    def _become(self) -> None:
        entry = pwd.getpwnam(self.user)
        if entry.pw_uid == os.getuid():
            return
        os.initgroups(entry.pw_name, entry.pw_gid)
        os.setgid(entry.pw_gid)
        os.setuid(entry.pw_uid)  # all threads of it, and for good: root's rights are gone
        os.environ |= {"HOME": entry.pw_dir, "USER": entry.pw_name, "LOGNAME": entry.pw_name}


def limits_of(given: Mapping[str, Any] | PolicyLimits | None) -> PolicyLimits:
    """Raise ``ValueError`` with what would be accepted."""
    if isinstance(given, PolicyLimits):
        limits = given
    else:
        try:
            limits = msgspec.convert({} if given is None else dict(given), PolicyLimits)
        except (msgspec.ValidationError, TypeError, ValueError) as error:
            known = ", ".join(PolicyLimits.__struct_fields__)
            raise ValueError(f"policy_limits: {error}. give some of {known}") from None
    limits.check()
    return limits


def _may_be_others() -> bool:
    """Become them, and end what runs as them."""
    if os.geteuid() == 0:
        return True
    try:
        with open("/proc/self/status") as file:
            mask = next(int(line.split()[1], 16) for line in file if line.startswith("CapEff:"))
    except (OSError, StopIteration, ValueError):
        return False
    return all(mask >> capability & 1 for capability in (_KILL, _SETGID, _SETUID))
