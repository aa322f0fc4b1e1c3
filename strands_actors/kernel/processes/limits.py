"""Limit a process that runs foreign code: its memory, its processors and its user.

The process sets the limits itself before it loads that code, and cannot remove them again (only root can raise
a limit or change its user). The limit of processors is an exception, since the process can remove it. It keeps
a policy from computing on all processors, but does not stop malicious code.
"""

from __future__ import annotations

import os
import pwd
import resource
from collections.abc import Mapping
from typing import Annotated, Any

import msgspec

_KILL, _SETGID, _SETUID = 5, 6, 7  # numbers of capabilities on Linux


class PolicyLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The limits of each process of a named policy.

    Attributes:
        memory_mb: Address space in MB. A library that reserves much memory needs more than it uses.
        cpu_s: Computing time of all threads together, in seconds. After it the kernel kills the process.
        processors: Number of the machine's processors that the process may run on.
        user: Name of the user that the process runs as; empty for the present user.
    """

    memory_mb: Annotated[int, msgspec.Meta(ge=64)] | None = None
    cpu_s: Annotated[int, msgspec.Meta(ge=1)] | None = None
    processors: Annotated[int, msgspec.Meta(ge=1)] | None = None
    user: str = ""

    def check(self) -> None:
        """Raise ``ValueError`` if this system lacks what a limit needs: the user, or the right to become that
        user."""
        if self.processors is not None and not hasattr(os, "sched_setaffinity"):
            raise ValueError("policy_limits: only Linux can limit processors. Leave processors out")
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
        """Apply the limits to this process for good. Raise ``OSError`` or ``ValueError`` if the system refuses
        one.
        """
        if self.processors is not None:
            # Take the last processors, since the first ones are the busiest.
            processors = sorted(os.sched_getaffinity(0))[-self.processors :]
            for thread in os.listdir("/proc/self/task"):
                os.sched_setaffinity(int(thread), processors)
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
        # This changes the user of all threads for good. The rights of root are gone afterwards.
        os.setuid(entry.pw_uid)
        os.environ |= {"HOME": entry.pw_dir, "USER": entry.pw_name, "LOGNAME": entry.pw_name}


def limits_of(settings: Mapping[str, Any] | PolicyLimits | None) -> PolicyLimits:
    """Return the limits from a mapping, checked. Raise ``ValueError``, which names the accepted keys, if a limit
    is wrong.
    """
    if isinstance(settings, PolicyLimits):
        limits = settings
    else:
        try:
            limits = msgspec.convert({} if settings is None else dict(settings), PolicyLimits)
        except (msgspec.ValidationError, TypeError, ValueError) as error:
            accepted = ", ".join(PolicyLimits.__struct_fields__)
            raise ValueError(f"policy_limits: {error}. Use only {accepted}") from None
    limits.check()
    return limits


def _may_be_others() -> bool:
    """Return True if this process may change its user, and may kill processes of other users."""
    if os.geteuid() == 0:
        return True
    try:
        with open("/proc/self/status") as file:
            mask = next(int(line.split()[1], 16) for line in file if line.startswith("CapEff:"))
    except (OSError, StopIteration, ValueError):
        return False
    return all(mask >> capability & 1 for capability in (_KILL, _SETGID, _SETUID))
