"""Build the shared library with the arm's model that clients load from a controller of FCI 5.

A controller compiles nothing, and neither does this module. It assembles the library for Linux on x86-64. The
thirty functions return zeros: no gravity, no Coriolis forces, no inertia beyond what the twin itself compensates,
and Jacobians and frames without use. Clients that control by joints need no more.
"""

from __future__ import annotations

import struct
from functools import cache

X86_64_LINUX = bytes((0, 0))
"""Architecture and system in a client's request for the library."""

_BASE = 0x1000
"""Offset of the code, on a separate page."""

# The result of a function is its last argument. This is the code "mov rdi, register" for the register of that
# argument (System V ABI).
_FROM = {
    "rdi": b"",
    "rsi": b"\x48\x89\xf7",
    "rdx": b"\x48\x89\xd7",
    "rcx": b"\x48\x89\xcf",
    "r8": b"\x4c\x89\xc7",
}
_JOINTS = range(1, 10)


def _functions() -> dict[str, tuple[str, int]]:
    """Return each function with the register of its result and the number of doubles in that."""
    functions = {"M_NE": ("rcx", 49), "c_NE": ("r8", 7), "g_NE": ("rcx", 7)}
    for joint in _JOINTS:
        # The first Jacobian depends on nothing. Those of the end effector get its frame, too.
        jacobian = "rdi" if joint == 1 else "rsi"
        functions[f"O_J_J{joint}"] = functions[f"Ji_J_J{joint}"] = (jacobian if joint < 9 else "rdx", 42)
        functions[f"O_T_J{joint}"] = ("rsi" if joint < 9 else "rdx", 16)
    return functions


def _code(register: str, count: int) -> bytes:
    """Return code that fills ``count`` doubles with zero: mov rdi, register; mov ecx, count; xor eax, eax; rep
    stosq; ret."""
    return _FROM[register] + b"\xb9" + struct.pack("<I", count) + b"\x31\xc0\xf3\x48\xab\xc3"


@cache
def model_library() -> bytes:
    """Return the library as an ELF file."""
    names, code, strings, symbols = _functions(), b"", b"\0", bytes(24)
    for name, (register, count) in names.items():
        body = _code(register, count)
        symbols += struct.pack("<IBBHQQ", len(strings), 0x12, 0, 1, _BASE + len(code), len(body))  # GLOBAL FUNC
        strings += name.encode() + b"\0"
        code += body
    total = len(names) + 1
    chain = struct.pack(f"<{total}I", 0, *((at + 1) % total for at in range(1, total)))
    table = struct.pack("<III", 1, total, 1) + chain  # one bucket, with every name in one chain
    symbols_at = 64 + 3 * 56
    strings_at = symbols_at + len(symbols)
    table_at = -(-(strings_at + len(strings)) // 8) * 8
    dynamic_at = -(-(table_at + len(table)) // 8) * 8
    tags = ((4, table_at), (5, strings_at), (6, symbols_at), (10, len(strings)), (11, 24), (0, 0))
    dynamic = b"".join(struct.pack("<QQ", *tag) for tag in tags)
    read_only = dynamic_at + len(dynamic)
    head = struct.pack("<16sHHIQQQIHHHHHH", _IDENT, 3, 62, 1, 0, 64, 0, 0, 64, 56, 3, 64, 0, 0)
    segments = (
        _segment(1, 6, 0, read_only),  # data; writable, since the loader notes there where the dynamic section is
        _segment(1, 5, _BASE, len(code)),
        _segment(2, 6, dynamic_at, len(dynamic)),
    )
    file = bytearray(_BASE)
    for at, part in (
        (0, head + b"".join(segments)),
        (symbols_at, symbols),
        (strings_at, strings),
        (table_at, table),
        (dynamic_at, dynamic),
    ):
        file[at : at + len(part)] = part
    return bytes(file) + code


_IDENT = b"\x7fELF\x02\x01\x01" + bytes(9)


def _segment(kind: int, flags: int, at: int, size: int) -> bytes:
    return struct.pack("<IIQQQQQQ", kind, flags, at, at, at, size, size, 0x1000 if kind == 1 else 8)
