"""Check the syntax of the option ``port``: a host, an IP address, a web address or a device path. Nothing is looked
up.

Each function that parses or checks raises ``ValueError`` with an accepted form in its text.
"""

from __future__ import annotations

import ipaddress
import os
import re
import stat

_LABEL = re.compile(r"(?!-)[\w-]{1,63}(?<!-)\Z")
_LONGEST_NAME = 253


def is_host(text: str) -> bool:
    """Return True if a text has the form of a host name or an IP address. A text of digits and dots must be an IPv4
    address."""
    if ":" in text or re.fullmatch(r"[0-9.]+", text):
        return is_ip(text)
    labels = text.removesuffix(".").split(".")
    return len(text) <= _LONGEST_NAME and all(_LABEL.match(label) for label in labels)


def is_ip(text: str, version: int = 0) -> bool:
    """Return True if a text is an IP address. With ``version`` 4 or 6 it must be of that version."""
    try:
        return ipaddress.ip_address(text).version == version or not version
    except ValueError:
        return False


def parse_address(text: str, default_port: int) -> tuple[str, int]:
    """Return host and port of a text in the form ``host``, ``host:port`` or ``[host]:port``."""
    host, port = text, str(default_port)
    if text.startswith("["):
        host, closed, rest = text[1:].partition("]")
        port = rest.removeprefix(":") if rest.startswith(":") else port if closed and not rest else ""
    elif text.count(":") == 1:
        host, _, port = text.partition(":")
    if not is_host(host) or not is_port_number(port):
        raise ValueError(f"port is {text!r}. Give an address: 192.0.2.10 or 192.0.2.10:{default_port}")
    return host, int(port)


def is_port_number(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) <= 5 and 0 < int(text) < 65536


def parse_web_address(text: str, default_port: int, service: str) -> tuple[str, int]:
    """Return the host and the port of a web address.

    Args:
        text: An address, with or without ``http://``.
        default_port: The port if the text has no port.
        service: The name of the service, for the message.
    """
    scheme, separator, rest = text.partition("://")
    if not separator:
        scheme, rest = "http", text
    rest = rest.removesuffix("/")
    if scheme != "http" or not rest or any(sign in rest for sign in "/?#@ "):
        raise ValueError(
            f"port is {text!r}. Give the address of {service}: 192.0.2.10:{default_port} or "
            f"http://192.0.2.10:{default_port}, without a user or a path. https is not supported"
        )
    return parse_address(rest, default_port)


def check_peer(text: str) -> None:
    """Raise ``ValueError`` unless ``text`` is the address of a DDS participant, ``host`` or ``host:port``. The
    host must be an IP address, because the sender of each received message is compared with it."""
    host, separator, port = text.partition(":")
    if not is_ip(host, 4) or (separator and not is_port_number(port)):
        raise ValueError(f"port is {text!r}. Give the robot's IPv4 address: 192.0.2.10")


def check_device(text: str) -> None:
    """Raise ``ValueError`` unless ``text`` can be the path of a serial device. The device need not exist yet,
    because it can be plugged in later."""
    host, _, port = text.partition(":")
    if "://" in text or is_ip(text) or (is_host(host) and is_port_number(port)):
        raise ValueError(f"port is {text!r}, an address. Give the path of a serial device: /dev/ttyACM0")
    if not text.isprintable():
        raise ValueError(f"port is {text!r}. Give the path of a serial device: /dev/ttyACM0")
    try:
        mode = os.stat(os.path.expanduser(text)).st_mode
    except OSError:
        return
    if not stat.S_ISCHR(mode):
        file_type = "folder" if stat.S_ISDIR(mode) else "file"
        raise ValueError(f"port is {text!r}, a {file_type}. Give the path of a serial device: /dev/ttyACM0")
