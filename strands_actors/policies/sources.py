"""Find the policy that ``robot.run(policy)`` means: an object, a name, a folder or a server.

``choose`` decides by the form of the argument. A known name comes first, so that a folder that happens to be called
``mock`` in the current directory changes nothing. ``./mock`` is the folder.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

from strands_actors.contract.shown import closest, shown

from . import registry
from .factory import create_policy
from .folders import PICKLES, pickle_refusal, read_folder


class Kind(StrEnum):
    """The form in which a policy was given."""

    OBJECT = "object"
    NAME = "name"
    FOLDER = "folder"
    SERVER = "server"


class Source(NamedTuple):
    """A policy, before it is made.

    Attributes:
        kind: The form in which it was given.
        label: Its name for people, as the user typed it; of an object, its name or type.
        policy: The object; None if another process makes the policy.
        provider: The name by which another process makes the policy; empty for an object.
        options: Keyword arguments for the policy.
        hz: Actions per second, if the policy states a rate; else None.
    """

    kind: Kind
    label: str
    policy: Any = None
    provider: str = ""
    options: Mapping[str, Any] = {}
    hz: float | None = None


def choose(policy: object, options: Mapping[str, Any]) -> Source:
    """Return the policy that an argument means.

    Args:
        policy: A policy object or a callable; a name; a folder, as text or ``Path``; the address of a server.
        options: Keyword arguments for a policy that another process makes.

    Raises:
        TypeError: It is no policy, or an object has options.
        ValueError: The name, the folder or the address is no policy. The text has the accepted forms.
    """
    if isinstance(policy, os.PathLike):
        policy = os.fspath(policy)
        return _of_folder(Path(str(policy)), options)
    if isinstance(policy, str):
        return _of_text(policy, options)
    return _of_object(policy, options)


def _of_object(policy: object, options: Mapping[str, Any]) -> Source:
    if policy is None:
        raise TypeError(
            "policy is None. Give a policy object, a callable, a name, a folder, ws://host:port or zmq://host:port"
        )
    # This module imports trio. A program that only lists policies does not need it.
    from strands_actors.supervisors.policy import as_infer

    as_infer(policy)
    if options:
        raise TypeError(f"{', '.join(options)}: of a policy that is made already. Give it to the policy itself")
    label = getattr(policy, "provider_name", None) or getattr(policy, "__name__", None) or type(policy).__name__
    return Source(Kind.OBJECT, shown(str(label)).strip("'\""), policy)


def _of_text(text: str, options: Mapping[str, Any]) -> Source:
    scheme, is_address, _ = text.partition("://")
    if is_address:
        if scheme.lower() not in registry.SCHEMES:
            raise ValueError(
                f"there is no client for {scheme}:// here. Give ws://host:port, of a server of this package, of "
                "strands-robots or of openpi, or zmq://host:port of GR00T"
            )
        return Source(Kind.SERVER, text, None, text, options)
    if (own := registry.registered_class(text)) is not None and registry.is_of_script(own):
        return Source(Kind.OBJECT, text, create_policy(text, **options))
    if text in registry.list_providers() or registry.is_alias(text) or (":" in text and os.sep not in text):
        return Source(Kind.NAME, text, None, text, options)
    if os.sep in text or text.startswith("~") or (text and os.path.exists(text)):
        return _of_folder(Path(text), options)
    names = sorted(registry.list_providers())
    near = closest(text, names)
    hint = f" ({near[0]}?)" if near else ""
    raise ValueError(
        f"{shown(text)}{hint} is no policy's name, and no folder here has this name. Use one of "
        f"{', '.join(names)}, or give a folder, ws://host:port or zmq://host:port"
    )


def _of_folder(path: Path, options: Mapping[str, Any]) -> Source:
    given, path = str(path), path.expanduser()
    if not os.path.exists(path):  # Unlike ``Path.exists``, it accepts a name of any length.
        raise ValueError(f"there is no folder {path}. Give the folder of a policy")
    if not path.is_dir():
        if path.suffix.lower() in PICKLES:
            raise ValueError(pickle_refusal(path.parent, path.name))
        raise ValueError(f"{path} is a file. Give the folder of the policy, {path.parent}")
    # The policy's process has another current directory than this program may have.
    found_policy = read_folder(path.resolve())
    if clash := sorted(set(found_policy.options) & set(options)):
        raise ValueError(f"{', '.join(clash)}: the folder sets it. Leave it out")
    return Source(
        Kind.FOLDER, given, None, found_policy.provider, {**options, **found_policy.options}, found_policy.hz
    )


__all__ = ["Kind", "Source", "choose"]
