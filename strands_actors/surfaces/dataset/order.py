"""The options of a recording, its events and its progress. No I/O."""

from __future__ import annotations

import enum

import msgspec


class Order(msgspec.Struct, frozen=True):
    """The options of a recording.

    Attributes:
        robot: The robot's name.
        root: The folder of the dataset.
        task: The task of the episodes, as a sentence.
        fps: Frames per second.
        cameras: Names of the cameras.
        codec: The codec of the videos. None means the codec of the existing videos, or the default for a new
            dataset.
        episodes: Number of episodes after which the recording ends. None means no limit.
        seconds: Length of an episode, if episodes begin and end automatically. None means on command.
        copy_to: The second place, to which finished episodes are copied. Empty if there is no such place.
    """

    robot: str
    root: str
    task: str
    fps: int = 30
    cameras: tuple[str, ...] = ()
    codec: str | None = None
    episodes: int | None = None
    seconds: float | None = None
    copy_to: str = ""


class State(enum.StrEnum):
    IDLE = "waiting"
    RECORDING = "recording"
    FINISHING = "finishing"


class Event(msgspec.Struct, frozen=True, omit_defaults=True):
    """An event of a recording, for the operator or a script.

    Attributes:
        type: ``ready``, ``started``, ``saved``, ``discarded``, ``refused`` or ``ended``; ``copy`` is news of the
            second place, ``not_copied`` lists at the end the episodes that it lacks; ``alive`` is a heartbeat.
        episode: The number of the episode.
        frames: The number of frames in the episode.
        defects: The defects of the episode as text.
        text: A message for the user.
        command_number: The number of the command that this event answers. 0 if the event answers no numbered
            command.
    """

    type: str = msgspec.field(name="what")
    episode: int = -1
    frames: int = 0
    defects: str = msgspec.field(default="", name="marks")
    text: str = ""
    command_number: int = msgspec.field(default=0, name="asked")

    @property
    def line(self) -> str:
        """The event as a line of text for the user."""
        match self.type:
            case "ready":
                return f"recording {self.text}"
            case "started":
                return f"episode {self.episode}: recording"
            case "saved":
                return f"episode {self.episode}: {self.frames} frames, {self.defects or 'nothing missing'}; saved"
            case "discarded":
                return f"episode {self.episode}: discarded"
            case _:
                return self.text


class Progress(msgspec.Struct, frozen=True):
    state: str
    episode: int
    done: int
    of: int | None
    seconds: float
    fps: float
    gaps: int
    late: int  # Number of frames with a state or a picture that is too old.
    free_bytes: int

    @property
    def line(self) -> str:
        """The progress as a line of text for the user."""
        done = f"{self.done}{'' if self.of is None else f'/{self.of}'} saved"
        free = f"{self.free_bytes / 1e9:.1f} GB left"
        if self.state == State.IDLE:
            return f"{done}, {free}"
        late = f", {self.late} late" if self.late else ""
        return f"{done}, {self.state} {self.seconds:.0f} s, {self.fps:.0f} fps, {self.gaps} gaps{late}, {free}"
