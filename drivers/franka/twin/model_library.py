"""Build the shared library with the arm's model that clients load from a controller of FCI 5.

This module needs no compiler: it writes the machine code for Linux on x86-64 by itself. The thirty functions return
zeros for gravity, Coriolis forces, inertia, Jacobians and frames. A client that commands joint positions does not
need them. The simulated arm compensates gravity by itself.
"""

from __future__ import annotations

import struct
from functools import cache

X86_64_LINUX = bytes((0, 0))
"""Architecture and system in a client's request for the library."""

_BASE = 0x1000
"""Offset of the code, on a separate page."""

# Each function writes its result to the address in its last argument. The System V ABI passes this address in a
# register. Each value here is the machine code of "mov rdi, register" for that register.
_FROM = {
    "rdi": b"",
    "rsi": b"\x48\x89\xf7",
    "rdx": b"\x48\x89\xd7",
    "rcx": b"\x48\x89\xcf",
    "r8": b"\x4c\x89\xc7",
}
_JOINTS = range(1, 10)


def _functions() -> dict[str, tuple[str, int]]:
    """Return each function's name with the register that has the address of its result, and the result's size.

    The size is a number of doubles.
    """
    functions = {"M_NE": ("rcx", 49), "c_NE": ("r8", 7), "g_NE": ("rcx", 7)}
    for joint in _JOINTS:
        # The Jacobian of joint 1 is constant, so its function has no joint positions as argument. The functions for
        # the end effector have its frame as an additional argument.
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
        symbols += struct.pack("<IBBHQQ", len(strings), 0x12, 0, 1, _BASE + len(code), len(body))  # global function
        strings += name.encode() + b"\0"
        code += body
    total = len(names) + 1
    chain = struct.pack(f"<{total}I", 0, *((index + 1) % total for index in range(1, total)))
    table = struct.pack("<III", 1, total, 1) + chain  # The hash table has one bucket, with all names in one chain.
    symbols_offset = 64 + 3 * 56
    strings_offset = symbols_offset + len(symbols)
    table_offset = -(-(strings_offset + len(strings)) // 8) * 8
    dynamic_offset = -(-(table_offset + len(table)) // 8) * 8
    tags = ((4, table_offset), (5, strings_offset), (6, symbols_offset), (10, len(strings)), (11, 24), (0, 0))
    dynamic = b"".join(struct.pack("<QQ", *tag) for tag in tags)
    read_only = dynamic_offset + len(dynamic)
    head = struct.pack("<16sHHIQQQIHHHHHH", _IDENT, 3, 62, 1, 0, 64, 0, 0, 64, 56, 3, 64, 0, 0)
    segments = (
        # The data segment is writable, because the loader writes the address of the dynamic section into it.
        _segment(1, 6, 0, read_only),
        _segment(1, 5, _BASE, len(code)),
        _segment(2, 6, dynamic_offset, len(dynamic)),
    )
    file = bytearray(_BASE)
    for offset, part in (
        (0, head + b"".join(segments)),
        (symbols_offset, symbols),
        (strings_offset, strings),
        (table_offset, table),
        (dynamic_offset, dynamic),
    ):
        file[offset : offset + len(part)] = part
    return bytes(file) + code


_IDENT = b"\x7fELF\x02\x01\x01" + bytes(9)


def _segment(segment_type: int, flags: int, offset: int, size: int) -> bytes:
    alignment = 0x1000 if segment_type == 1 else 8
    return struct.pack("<IIQQQQQQ", segment_type, flags, offset, offset, offset, size, size, alignment)
