"""Create a policy by its name, as an object of this process."""

from __future__ import annotations

import inspect
from typing import Any

from strands_actors.contract.loading import load
from strands_actors.contract.shown import closest

from .registry import find_provider, registered_class

OF_THIS_PROCESS = {
    "mock": "strands_actors.policies.mock:MockPolicy",
    "remote": "strands_actors.policies.remote:RemotePolicy",
}
"""Built-in policies that can be made without a robot."""


def create_policy(provider: str, **options: Any) -> Any:
    """Return a policy object for ``run_policy``.

    Args:
        provider: ``mock``, ``remote``, a name that was registered by ``register_policy``, or the address of a
            policy server, ``ws://host:port``.
        options: Keyword arguments of the policy.

    Raises:
        ValueError: The name or an option is unknown, or the policy must know its robot before it is
            made (use ``start_task``).

    Example:
        arm.run_policy(create_policy("mock", amplitude=2.0), duration=5.0)
    """
    if not isinstance(provider, str) or not provider:
        raise ValueError(f"create_policy: the provider is {provider!r}. Give a name, or ws://host:port")
    if provider.lower().startswith("ws://"):
        provider, options = "remote", {"endpoint": provider, **options}
    factory = registered_class(provider)
    if factory is None:
        entry = find_provider(provider)
        if provider not in OF_THIS_PROCESS:
            raise ValueError(
                f"create_policy: {provider} has to know its robot. "
                f"Use start_task(policy_provider={provider!r}, ...), which tells it" + _object_hint(entry.where)
            )
        factory = load(OF_THIS_PROCESS[provider])
    _check_options(provider, factory, options)
    return factory(**options)


def _object_hint(object_path: str) -> str:
    return f", or make an object of {object_path}"


def _check_options(name: str, factory: Any, options: dict[str, Any]) -> None:
    parameters = inspect.signature(factory).parameters
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values()):
        return
    for option in options:
        if option not in parameters:
            close = closest(option, parameters)
            hint = f" ({option!r} -> {close[0]!r}?)" if close else ""
            accepted = ", ".join(parameters) or "nothing"
            raise ValueError(f"create_policy: {name} takes no {option!r}{hint}. It takes {accepted}")
