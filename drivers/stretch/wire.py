"""Drive a Stretch: five boards and two chains of servos, each on its own port, all called at the same time.
This module runs in the wire process.

A setpoint is sent only to the axes that its action names. The wheels' velocity is repeated while it is in
force, because their firmware's watchdog needs that. Lift, arm and servos move to a goal by their own profiles.
Lift and arm get a goal once. A board that has stopped at a contact would take the same goal as a new command
and push again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, ClassVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, Wire, WireDown, all_safe
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.half_duplex import Quiet
from strands_actors.drivers.common.ports.serial_port import open_serial
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused, sentence_case

from . import protocol as p
from . import refusals
from .board import ANSWER_S, Board, OpenPort
from .chains import ChainWire
from .config import ARM, BASE, BAUD, BOARDS, LEFT, LIFT, PIMU, RIGHT, STEPPERS, StretchConfig
from .gates import named_in, runstop_cause
from .readings import Readings
from .safing import CONFIRM_S, boards_for, make_safe, unreachable
from .stop_channel import StretchStopChannel
from .together import together

OLD_S = 0.3
"""How long a stop is tried on ports that count as lost, before they are opened anew."""
QUIET_LOOK_S = 0.02
"""Period of the check whether a board that missed an answer may get the call again."""


class StretchWire(Wire):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: StretchConfig, clock: Clock, open_port: OpenPort = open_serial) -> None:
        self._config = config
        self._clock = clock
        self._open_port = open_port
        self._boards: dict[str, Board] = {}
        self._chains: list[ChainWire] = []
        self._readings = Readings(config, 0)
        self._armed = False
        # The goals that the boards of lift and arm have acknowledged.
        self._goals: dict[str, p.Command] = {}

    # -- the link

    async def open(self) -> dict[str, Any]:
        self.close()
        config = self._config
        try:
            for name in BOARDS:
                self._boards[name] = Board(name, self._open_port(config.usb(name), BAUD), self._clock)
            self._chains = [ChainWire(config, chain, self._clock, self._open_port) for chain in config.chains]
            facts = await together(
                *(partial(self._set_up, self._boards[name]) for name in BOARDS),
                *(chain.open for chain in self._chains),
            )
            flash = await together(*(partial(self._flash_watchdog, self._boards[name]) for name in (LEFT, RIGHT)))
        except BaseException:
            self.close()
            raise
        self._begin()
        infos = {name: self._boards[name].info for name in BOARDS}
        return {
            "model": config.parameters.model_name,
            "tool": config.parameters.tool,
            "firmware": {name: info.firmware for name, info in infos.items()},
            "velocity_watchdog": {
                name: {"acknowledged": config.motors[name].has_watchdog, "in_flash": stored}
                for name, stored in zip((LEFT, RIGHT), flash, strict=True)
            },
            "servos": {
                chain.config.port: fact for chain, fact in zip(self._chains, facts[len(BOARDS) :], strict=True)
            },
        }

    async def _set_up(self, board: Board) -> dict[str, Any]:
        """Send the gains and limits of the robot's YAML to the boards, as the robot's own software does at its
        start. Nothing moves."""
        if board.name == PIMU:
            await board.identify(p.Kind.PIMU)
            await board.must(p.pimu_config_call(self._config.parameters.pimu_config), "its configuration")
            return {}
        await board.identify(p.Kind.STEPPER)
        motor = self._config.motors[board.name]
        await board.must(motor.gains.call(board.info.protocol), "its gains")
        if board.name in (LIFT, ARM):
            await board.must(self._limits(board.name, motor.low_m, motor.high_m), "its limits of motion")
        return {}

    def _limits(self, joint: str, low_m: float, high_m: float) -> bytes:
        scale = self._config.motors[joint].rad_per_m
        return p.motion_limits(low_m * scale, high_m * scale)

    async def _flash_watchdog(self, board: Board) -> bool:
        """Return True if the gains in flash memory switch the velocity watchdog on. These gains apply after a
        reset of the board. The present gains were acknowledged before."""
        data = await board.ask(p.FLASH_GAINS, wait=True)
        if data is None:
            raise WireDown(f"{board.name} does not report its gains in flash. Check its cable and power")
        try:
            return bool(p.parse_gains(data).config & p.Config.VELOCITY_WATCHDOG)
        except MalformedFrame as malformed:
            message = f"{board.name} does not report its gains in flash: {malformed}. Check its firmware"
            raise WireDown(message) from None

    def _begin(self) -> None:
        config, parameters = self._config, self._config.parameters
        readings = self._readings = Readings(config, self._boards[PIMU].info.hardware)
        readings.limits = {
            LIFT: (parameters.lift.low_m, parameters.lift.high_m),
            ARM: (parameters.arm.low_m, parameters.arm.high_m),
            **{axis.key: axis.limits for chain in self._chains for axis in chain.axes},
        }
        readings.has_watchdog = parameters.left.has_watchdog and parameters.right.has_watchdog

    def handover(self) -> Sequence[int]:
        descriptors = [self._boards[name].port.fileno() for name in BOARDS if name in self._boards]
        descriptors += [fd for chain in self._chains for fd in chain.handover()]
        return descriptors if len(descriptors) == len(BOARDS) + len(self._config.chains) else ()

    def close(self) -> None:
        for board in self._boards.values():
            board.close()
        for chain in self._chains:
            chain.close()
        self._boards, self._chains = {}, []
        self._armed = False
        self._goals = {}

    # -- reading

    async def read(self) -> Observation:
        self._check_open()
        steppers = (partial(self._read_stepper, name) for name in STEPPERS)
        chains = (partial(self._read_chain, chain) for chain in self._chains)
        await together(*steppers, self._read_pimu, *chains)
        return self._observation()

    async def _read_stepper(self, name: str) -> None:
        board = self._boards[name]
        try:
            status = await board.stepper_status()
        except Quiet:
            status = None
        now_ns = self._clock.now_ns()
        if not self._readings.stepper(name, status, now_ns):
            raise WireDown(f"read: {name} was reset. Check its supply, then connect again, which sets its gains")
        self._check_silence(name, now_ns)

    async def _read_pimu(self) -> None:
        try:
            status = await self._boards[PIMU].pimu_status()
        except Quiet:
            status = None
        now_ns = self._clock.now_ns()
        if not self._readings.pimu(status, now_ns):
            raise WireDown(
                f"read: {PIMU} was reset. Check its supply, then connect again, which sets its configuration"
            )
        self._check_silence(PIMU, now_ns)

    async def _read_chain(self, chain: ChainWire) -> None:
        await chain.read()

    def _check_silence(self, name: str, now_ns: int) -> None:
        silent_ns = self._readings.silent_for_ns(name, now_ns)
        if silent_ns > self._config.timeout_s * NS:
            raise WireDown(
                f"read: {name} reports nothing new for {silent_ns / 1e6:.0f} ms. Check its cable and power"
            )

    def _observation(self) -> Observation:
        for chain in self._chains:
            self._readings.homed.update(chain.homed)
        return self._readings.observation([chain.observation for chain in self._chains], self._clock.now_ns())

    # -- commanding

    async def arm(self, permit: Permit) -> Observation:
        """Prepare the robot for commands. Every axis is held where it is."""
        self._check_open()
        observation = await self.read()
        if "runstop" not in observation.sensors:
            raise WireDown(
                "arming: the power board does not report whether the runstop is pressed. Check its cable"
            )
        if observation.sensors["runstop"] != (0.0,):
            cause = runstop_cause(observation.sensors)
            reason, remedy = refusals.runstop(cause).reason, refusals.runstop_remedy(cause)
            raise WireDown(f"arming: {reason}. {sentence_case(remedy)}")
        permit.check()
        self._armed = True
        self._goals = {}
        for name in STEPPERS:
            self._boards[name].send(self._config.hold(name).call())
        await together(*(partial(chain.arm, permit) for chain in self._chains))
        await self._await_hold()
        return await self.read()

    async def _await_hold(self) -> None:
        statuses = await together(*(partial(self._boards[name].stepper_status, wait=True) for name in STEPPERS))
        for name, status in zip(STEPPERS, statuses, strict=True):
            if status is None or status.mode != p.Mode.HOLD:
                reported = "nothing" if status is None else f"mode {status.mode}"
                raise WireDown(
                    f"arming: {name} was commanded to hold, but reports {reported}. Check its cable and the runstop"
                )
            self._readings.store_energised(name, status, self._clock.now_ns())

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        """Write a setpoint to the named axes. All frames are sent at once. Then the acknowledgements of lift
        and arm are awaited. A board that has not acknowledged its goal gets it again with the next repetition."""
        self._check_open()
        if not self._armed:
            raise PermitDenied("not armed")
        config = self._config
        named = named_in(values, config.axes)
        target = dict(zip(config.axes, values, strict=False))
        permit.check()
        if any(axis in named for axis in BASE):
            for wheel, speed_m_s in zip((LEFT, RIGHT), config.wheels(target["vx"], target["wz"]), strict=True):
                self._boards[wheel].send(config.drive(wheel, speed_m_s).call())
        goals = {joint: config.goal(joint, target[joint]) for joint in (LIFT, ARM) if joint in named}
        sent = {joint: goal for joint, goal in goals.items() if self._goals.get(joint) != goal}
        for joint, goal in sent.items():
            self._goals.pop(joint, None)
            self._boards[joint].tell(goal.call())
        for chain in self._chains:
            if any(axis.key in named for axis in chain.axes):
                await chain.write(tuple(target[axis.key] for axis in chain.axes), permit)
            else:
                chain.feed_watchdogs()
        acknowledged = await together(*(partial(self._boards[joint].was_acknowledged) for joint in sent))
        self._goals.update(
            row for row, is_acknowledged in zip(sent.items(), acknowledged, strict=True) if is_acknowledged
        )

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        """Run the service ``set_soft_limits``. The boards of lift and arm get the limits, too."""
        self._check_open()
        joint, low, high = str(arguments["joint"]), float(arguments["low"]), float(arguments["high"])
        permit.check()
        if joint in (LIFT, ARM):
            await self._change(self._boards[joint], self._limits(joint, low, high), permit)
        self._readings.limits[joint] = (low, high)
        return {"joint": joint, "low": low, "high": high}

    async def _change(self, board: Board, call: bytes, permit: Permit) -> None:
        """Send a call (a request to a board) until it is acknowledged, while ``read`` and ``write`` continue."""
        with trio.move_on_after(ANSWER_S):
            while True:
                try:
                    if await board.change(call, permit):
                        return
                except Quiet:
                    await trio.sleep(QUIET_LOOK_S)
        raise WireDown(f"{board.name} did not acknowledge its motion limits. Check its cable and power")

    # -- safe

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop all boards at once. After a hold because of a late command, the robot stays armed."""
        self._goals = {}
        if safe_state == SafeState.STOP:
            self._armed = False
            self._readings.clear_energised()
        names = boards_for(safe_state)
        if not self._boards:
            return tuple(unreachable(name, "not connected") for name in names)
        return await self._stop(safe_state)

    async def _stop(self, safe_state: SafeState, within_s: float = CONFIRM_S) -> tuple[MotorReport, ...]:
        reports: list[MotorReport] = []

        async def stop_board(name: str) -> None:
            reports.append(await make_safe(self._boards[name], self._config, within_s))

        async def stop_chain(chain: ChainWire) -> None:
            reports.extend(await chain.make_safe(safe_state))

        async with trio.open_nursery() as nursery:
            for name in boards_for(safe_state):
                nursery.start_soon(stop_board, name)
            for chain in self._chains:
                nursery.start_soon(stop_chain, chain)
        return tuple(sorted(reports, key=lambda report: report.id))

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the robot after its link was lost: first on the old ports, then on all ports opened again."""
        if self._boards:
            with trio.move_on_after(OLD_S):
                reports = await self._stop(safe_state, OLD_S)
                if all_safe(reports):
                    self.close()
                    return reports
        self.close()
        channel = StretchStopChannel(self._config, (), self._clock, self._open_port)
        try:
            return await channel.make_safe(safe_state)
        finally:
            channel.close()

    def _check_open(self) -> None:
        if not self._boards or not self._chains:
            raise WireDown("not connected. Connect first")
