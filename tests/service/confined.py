"""``python confined.py UNIT COMMAND ...``: a command under the unit's limits on system calls, without systemd.

SystemCallFilter, RestrictAddressFamilies, MemoryDenyWriteExecute and NoNewPrivileges are read from the unit and put
into force by libseccomp, as systemd does; the groups of calls are those that `systemd-analyze syscall-filter` tells.
"""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
import socket
import subprocess
import sys
from pathlib import Path

ALLOW, REFUSE = 0x7FFF0000, 0x00050000 | errno.EPERM
EQUAL, MASKED_EQUAL = 4, 7
PR_SET_NO_NEW_PRIVS = 38


class Comparison(ctypes.Structure):
    """What an argument of a call must be: `scmp_arg_cmp`."""

    _fields_ = [("arg", ctypes.c_uint), ("op", ctypes.c_int), ("a", ctypes.c_uint64), ("b", ctypes.c_uint64)]


def settings(unit: Path, name: str) -> list[str]:
    lines = unit.read_text().splitlines()
    return [line.partition("=")[2] for line in lines if line.startswith(f"{name}=")]


def calls_of(name: str) -> set[str]:
    """A call, or the calls of a group and of the groups in it."""
    if not name.startswith("@"):
        return {name}
    told = subprocess.run(["systemd-analyze", "syscall-filter", name], check=True, capture_output=True, text=True)
    members = [line.strip() for line in told.stdout.splitlines()[1:] if line.strip() and "#" not in line]
    return set().union(*map(calls_of, members))


def allowed(unit: Path) -> set[str]:
    """The first line lets in; lines with a tilde take out."""
    calls: set[str] = set()
    for line in settings(unit, "SystemCallFilter"):
        named = set().union(*map(calls_of, line.removeprefix("~").split()))
        calls = calls - named if line.startswith("~") else calls | named
    return calls


def conditions(unit: Path) -> dict[str, list[Comparison]]:
    """Calls that are allowed if one of their comparisons holds."""
    (families,) = settings(unit, "RestrictAddressFamilies")
    found = {"socket": [Comparison(0, EQUAL, getattr(socket, name), 0) for name in families.split()]}
    if settings(unit, "MemoryDenyWriteExecute") == ["yes"]:
        both = mmap.PROT_WRITE | mmap.PROT_EXEC
        found["mmap"] = [Comparison(2, MASKED_EQUAL, both, value) for value in (0, mmap.PROT_WRITE, mmap.PROT_EXEC)]
        found["mprotect"] = found["pkey_mprotect"] = [Comparison(2, MASKED_EQUAL, mmap.PROT_EXEC, 0)]
    return found


def confine(unit: Path) -> None:
    library = ctypes.CDLL("libseccomp.so.2")
    library.seccomp_init.restype = ctypes.c_void_p
    context = ctypes.c_void_p(library.seccomp_init(ctypes.c_uint32(REFUSE)))
    conditional = conditions(unit)
    for call in sorted(allowed(unit)):
        number = library.seccomp_syscall_resolve_name(call.encode())
        for one in conditional.get(call, [None]):
            array = None if one is None else (Comparison * 1)(one)
            code = library.seccomp_rule_add_array(
                context, ctypes.c_uint32(ALLOW), number, 0 if one is None else 1, array
            )
            assert code == 0 or number < 0, (call, code)  # negative: not a call of this machine
    if settings(unit, "NoNewPrivileges") == ["yes"]:
        assert ctypes.CDLL(None).prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0
    assert library.seccomp_load(context) == 0


if __name__ == "__main__":
    confine(Path(sys.argv[1]))
    os.execv(sys.argv[2], sys.argv[2:])
