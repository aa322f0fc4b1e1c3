"""Write the sections of a robot's page from the tables by which the robot is driven."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

from strands_actors.contract.axis import Axis, AxisMode
from strands_actors.contract.driver import Condition, Driver, OnResume, Reason, Service
from strands_actors.contract.safe_state import SafeState
from strands_actors.kernel.messages import sentence_case
from strands_actors.testing.matrix import Row

from . import facts
from .gates import GateFacts, gate_facts
from .options import options_of

ORDERED = {Reason.STOP: "`stop()`", Reason.ESTOP: "an e-stop", Reason.CLEANUP: "`cleanup()`"}
"""Reasons that need no explanation."""

RESUME = {
    OnResume.REFUSE: "refuses",
    OnResume.ARM_ANEW: "arms the robot again",
    OnResume.STAY_ARMED: "changes nothing",
}


def level_sections(driver: Driver, heading: str) -> Iterator[str]:
    yield from _joints(driver, heading)
    yield from _safe_states(driver, heading)
    yield from (f"{heading} What its firmware does alone", "")
    yield from (
        "If all processes of this package have ended, only the robot's firmware can act. Its watchdog, as "
        "`get_status()` shows it:",
        "",
        f"> {sentence_case(driver.firmware_watchdog).rstrip('.')}.",
        "",
    )
    yield from _gates(driver, heading)
    yield from _verbs(driver, heading)


def _joints(driver: Driver, heading: str) -> Iterator[str]:
    yield from (f"{heading} Joints", "")
    yield from (f"!!! note\n    {sentence_case(text).rstrip('.')}." for text in driver.caveats)
    if driver.caveats:
        yield ""
    axes = [(part.name or str(part.kind), axis) for part in driver.parts for axis in part.axes]
    yield from table(("joint", "part", "number", "unit", "lowest", "highest", "most per second"), map(_axis, axes))
    yield ""
    if driver.READ_ONLY_JOINTS:
        joints = ", ".join(f"`{joint.key}` ({joint.unit})" for joint in driver.READ_ONLY_JOINTS)
        yield from (f"Measured, but not commanded: {joints}.", "")


def _axis(row: tuple[str, Axis]) -> tuple[str, ...]:
    part, axis = row
    kind = " (a speed)" if axis.mode is AxisMode.VELOCITY else ""
    optional = " (not on every robot)" if axis.optional else ""
    limits = map(number, (axis.low, axis.high, axis.speed))
    return f"`{axis.key}`{kind}{optional}", part, str(axis.id), axis.unit or "–", *limits


def number(value: float) -> str:
    """Return a number of a driver's table with at most six digits."""
    return "no limit" if math.isinf(value) else f"{value:.6g}"


def _safe_states(driver: Driver, heading: str) -> Iterator[str]:
    states, reasons = facts.comments(SafeState), facts.comments(Reason)
    by_state: dict[SafeState, list[Reason]] = {}
    for reason, state in driver.fallbacks.items():
        by_state.setdefault(state, []).append(reason)
    yield from (f"{heading} Safe states", "")
    rows = [
        (
            f"`{state}`",
            states[state],
            "<br>".join(f"{ORDERED.get(reason) or reasons[reason]} (`{reason}`)" for reason in by_state[state]),
        )
        for state in sorted(by_state, key=lambda state: state.severity)
    ]
    yield from table(("safe state", "the robot", "after"), rows)
    yield ""
    timing = driver.timing
    single = "as long as the lease" if timing.oneshot_ttl_s is None else f"{timing.oneshot_ttl_s * 1e3:g} ms"
    times = (
        ("setpoints of a stream", f"{timing.control_hz:g} a second"),
        ("lifetime of a setpoint of a stream", f"{timing.stream_ttl_s * 1e3:g} ms"),
        ("lifetime of a single command", single),
        ("a reading counts for", f"{timing.state_ttl_s * 1e3:g} ms"),
        ("a process without a heartbeat counts as frozen after", f"{timing.heartbeat_ttl_s * 1e3:g} ms"),
        ("longest time of a stop with its confirmation", f"{timing.safe_s:g} s"),
    )
    yield from table(("time", ""), times)
    yield ""


def _gates(driver: Driver, heading: str) -> Iterator[str]:
    yield from (f"{heading} Gates", "")
    yield from (
        "A gate refuses a command before anything is written. The gates are asked in this order, and a refusal "
        "has one of these codes ([refusals](../refusals.md)).",
        "",
    )
    rows = dict.fromkeys((_code(gate.name), gate.about, _codes(gate)) for gate in map(gate_facts, driver.gates))
    yield from table(("gate", "what it does", "codes"), rows)
    yield ""
    if driver.conditions:
        yield from (
            f"{heading} Conditions",
            "",
            "A condition must be true of the robot while it is commanded. If it becomes false, the motion ends.",
            "",
        )
        conditions = [_condition(driver, each) for each in driver.conditions]
        yield from table(("condition", "what it does", "codes", "safe state", "`resume()` meanwhile"), conditions)
        yield ""


def _condition(driver: Driver, condition: Condition) -> tuple[str, ...]:
    gate = gate_facts(condition.check)
    state = condition.safe_state or driver.fallbacks[condition.reason]
    held = ", also in a hold" if condition.always else ""
    return _code(gate.name), gate.about, _codes(gate), f"`{state}`{held}", RESUME[condition.on_resume]


def _codes(gate: GateFacts) -> str:
    return ", ".join(f"`{code}`" for code in gate.codes) or "–"


def _verbs(driver: Driver, heading: str) -> Iterator[str]:
    yield from (f"{heading} Verbs and services", "")
    yield from (
        "An agent, an MCP client and an operator on the mesh have these verbs. An input with `*` is required.",
        "",
    )
    rows = []
    for verb in driver.TOOL_VERBS:
        inputs = ", ".join(f"`{name}`{'*' if name in verb.required else ''}" for name in verb.inputs) or "–"
        asks = verb.name in driver.GUARDED or verb.does == "torque"
        approval = "with approval" if asks else ""
        rows.append((f"`{verb.name}`", inputs, verb.description, approval))
    yield from table(("verb", "inputs", "what it does", ""), rows)
    yield ""
    keys = [name for name in driver.GUARDED if name not in {verb.name for verb in driver.TOOL_VERBS}]
    if keys:
        yield from (f"Actions with {names(keys)} need an operator's approval, except zero.", "")
    if services := driver.SERVICES:
        yield from ("A script also has these methods of the robot:", "")
        yield from table(("method", "what it does", "within", ""), [_service(*each) for each in services.items()])
        yield ""


def _service(name: str, service: Service) -> tuple[str, ...]:
    arguments = ", ".join(f"{key}={value!r}" for key, value in service.arguments.items())
    notes = [
        note
        for applies, note in (
            (service.moves, "moves the robot"),
            (service.powers and service.arms({}), "energises, so not on a stopped robot"),
            (service.powers and not service.arms({}), "takes power away"),
            (service.ends_motion, "ends a motion"),
            (service.stops is not None, "is a stop"),
        )
        if applies
    ]
    return f"`{name}({arguments})`", sentence_case(service.about), f"{service.within_s:g} s", ", ".join(notes)


def options_section(robot: str) -> Iterator[str]:
    yield from ("## Options", "")
    options = options_of(facts.driver_class(robot))
    if not options:
        yield from ("`Robot(...)` takes no options for this robot besides those of every robot.", "")
        return
    yield from ("`Robot(...)` takes these keywords for this robot, besides those of every robot.", "")
    rows = [
        (
            f"`{option.name}`" + (f", `{option.other_name}`" if option.other_name else ""),
            option.type,
            f"`{option.default}`",
            sentence_case(option.about),
        )
        for option in options
    ]
    yield from table(("option", "type", "default", "meaning"), rows)
    yield ""


# -- the kill matrix


def matrix_section(robot: str) -> Iterator[str]:
    yield from ("## Kill matrix", "")
    measured = facts.measured_like(robot)
    if robot not in measured:
        if measured:
            links = ", ".join(f"[`{other}`]({other}.md#kill-matrix)" for other in measured)
            yield f"This robot was not measured. Its driver was measured on the twin of {links}."
        else:
            yield "This robot was not measured."
        yield ""
        return
    column = facts.matrix()[robot]
    rows = [row for row in column.rows if not row.why_not]
    after = sum(row.setpoints_after for row in rows)
    worst = max((row for row in rows if row.worst_ms is not None), key=_share_of_bound)
    yield (
        f"{len(rows)} faults, {sum(row.trials for row in rows)} trials on the twin, {after} setpoints after a safe "
        f"frame. Closest to its bound: {worst.victim} × {worst.fault}, {worst.worst_ms:.1f} ms of "
        f"{worst.bound_ms:.0f} ms. All figures: [kill matrix](../kill-matrix.md#{robot})."
    )
    yield ""
    by_victim: dict[str, list[Row]] = {}
    for row in rows:
        by_victim.setdefault(row.victim, []).append(row)
    yield from table(
        ("victim", "faults", "closest to its bound", "worst", "bound"), map(_victim, by_victim.items())
    )
    yield ""


def _victim(item: tuple[str, Sequence[Row]]) -> tuple[str, ...]:
    victim, rows = item
    worst = max(rows, key=_share_of_bound)
    return victim, str(len(rows)), worst.fault, f"{worst.worst_ms or 0.0:.1f} ms", f"{worst.bound_ms:.0f} ms"


def _share_of_bound(row: Row) -> float:
    return (row.worst_ms or 0.0) / row.bound_ms if row.bound_ms else 0.0


# -- Markdown


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a Markdown table.

    Args:
        head: The titles of the columns.
        rows: The cells of each row.
    """
    yield _line(head)
    yield "|" + "---|" * len(head)
    yield from map(_line, rows)


def _line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"


def _code(name: str) -> str:
    return f"`{name}`"


def names(names: Iterable[str]) -> str:
    return ", ".join(map(_code, names))
