"""The calls to Stretch's boards that the simulated robot models, and the bits of their triggers."""

from __future__ import annotations

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.stretch import protocol as p

FAN_ON, FAN_OFF, BUZZER_ON, BUZZER_OFF, BOARD_RESET, BEEP = 32, 64, 8, 16, 1, 512
"""Triggers of the power board beside those of ``protocol``, from the vendor's client."""

WRITE_GAINS_TO_FLASH = 8
"""Trigger of a stepper that keeps its gains."""

NO_REPLY = b"\0"
"""Reply to a call that is not modelled. Its number is not the call's, so the vendor's client logs an error
[assumed]. An empty reply would end that client with an exception."""

_OTHERWISE = "a reply with the number 0, which the vendor's client reports as an error"

STEPPER_CALLS: Modelled[int] = Modelled(
    "calls to a stepper",
    {
        p.BOARD_INFO[p.Kind.STEPPER]: "returns the names of board and firmware",
        p.COMMAND: "moves, holds or frees the motor; a contact ends a guarded motion; an unknown mode is ignored",
        p.STATUS: "returns position, velocity, effort, contacts and flags",
        p.GAINS: "stores the gains; their flags switch runstop, sync, guarded mode and watchdog",
        p.TRIGGER: "marks the position or the homing, stores the gains in flash, or restarts the board",
        p.FLASH_GAINS: "returns the gains in flash",
        p.MOTION_LIMITS: "limits positions of a homed motor",
        p.START_TRAJECTORY: "begins a trajectory with segment 2; returns 0 for another one, and while one runs",
        p.NEXT_SEGMENT: "keeps the next segment; ignores one with another number",
        p.RESET_TRAJECTORY: "ends the trajectory where the motor is",
        p.STATUS_AUX: "returns the counters of commands and sync pulses",
    },
    _OTHERWISE,
)
STEPPER_MODES: Modelled[int] = Modelled(
    "modes of a stepper",
    {
        p.Mode.SAFETY: "holds or frees the motor, as its gains say",
        p.Mode.FREEWHEEL: "frees the motor",
        p.Mode.HOLD: "holds the motor",
        p.Mode.POSITION: "moves to a position at once",
        p.Mode.VELOCITY: "turns with a velocity at once",
        p.Mode.POSITION_PROFILE: "moves to a position with a profile",
        p.Mode.VELOCITY_PROFILE: "turns with a velocity and a profile",
        p.Mode.STEP_PROFILE: "moves by a distance with a profile",
        p.Mode.WAYPOINTS: "follows the trajectory, and holds without one",
    },
    "the command is ignored, and the status keeps the present mode",
)
STEPPER_TRIGGERS = p.MARK_POSITION | p.BOARD_RESET | WRITE_GAINS_TO_FLASH | p.RESET_HOMED | p.SET_HOMED
"""The bits of a stepper's trigger that are modelled."""

PIMU_CALLS: Modelled[int] = Modelled(
    "calls to the power board",
    {
        p.BOARD_INFO[p.Kind.PIMU]: "returns the names of board and firmware",
        p.PIMU_CONFIG: "stores whether the runstop stops the motors",
        p.PIMU_STATUS: "returns battery, IMU, runstop and alerts",
        p.PIMU_TRIGGER: "switches runstop, fan and buzzer, beeps, clears a cliff, or restarts the board",
        p.MOTOR_SYNC: "starts the commands that wait in all steppers",
        p.PIMU_STATUS_AUX: "returns the board's counters",
    },
    _OTHERWISE,
)
PIMU_TRIGGERS = (
    p.RUNSTOP_RESET | p.RUNSTOP_ON | p.CLIFF_RESET | FAN_ON | FAN_OFF | BUZZER_ON | BUZZER_OFF | BOARD_RESET | BEEP
)
"""The bits of the power board's trigger that are modelled."""

WACC_CALLS: Modelled[int] = Modelled(
    "calls to the wrist board",
    {
        p.BOARD_INFO[p.Kind.WACC]: "returns the names of board and firmware",
        p.WACC_CONFIG: "stores the scale of the acceleration",
        p.WACC_STATUS: "returns the acceleration and the digital outputs",
        p.WACC_COMMAND: "sets the digital outputs",
    },
    _OTHERWISE,
)
