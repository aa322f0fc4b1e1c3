"""Run the services of a Reachy Mini. Each is one request to the daemon. Some begin a move and wait for its end."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import trio

from strands_actors.contract.wire import Observation, Permit, WireDown
from strands_actors.drivers.common.codecs.http_messages import Response
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.http_port import HttpPort
from strands_actors.kernel.messages import Refused

from . import protocol as p
from . import refusals
from .config import ReachyConfig, parse_speech_url
from .gates import EASE, SHORTEST_S
from .verbs import ALSO

ASK_S = 4.0
"""Timeout for the answer to a request."""

BEGIN_S = 0.5
"""Timeout for the begin of a move."""

SWITCH_S = 1.5
"""Timeout for switching the motors [assumed]. It is shorter than the time for which a stop waits."""

FETCH_S = 25.0
"""Timeout for the list of moves of a dataset, which the daemon may download first."""

SPEECH_S = 20.0
"""Timeout for making speech of a text [assumed]."""

SPEECH_SIZE = 4 << 20
"""Most bytes of a WAV file: 40 s at 48 kHz."""

SPEECH = "strands-speech.wav"
"""Name of the file with speech on the robot."""

BOUNDARY = "strands-actors-speech"

TURN_DEG_S = 240.0
"""Average speed of the head, as in ``robots.toml``."""

KEPT = 16
"""Number of moves of ours, and of ended moves, to remember."""


OVER_S = 0.05
"""A move that is completed this soon was not played, because another one runs."""


class Moves:
    """Our moves by id, and how they ended. ``running`` is the id of our newest move until its end is known."""

    def __init__(self) -> None:
        self.running = ""
        self._own_ids: deque[str] = deque(maxlen=KEPT)
        self._ended: dict[str, p.Update] = {}
        self._end_received = trio.Event()

    def begin(self, uuid: str) -> None:
        self._own_ids.append(uuid)
        if uuid not in self._ended:
            self.running = uuid

    def process(self, update: p.Update) -> None:
        if update.event_type not in p.ENDS:
            return
        self._ended[update.uuid] = update
        while len(self._ended) > KEPT:
            self._ended.pop(next(iter(self._ended)))
        if self.running == update.uuid:
            self.running = ""
        self._end_received.set()
        self._end_received = trio.Event()

    def has_foreign(self, running: Sequence[str]) -> bool:
        """Return True if any of these running moves is not ours."""
        return any(uuid not in self._own_ids for uuid in running)

    async def ignored(self, uuid: str) -> bool:
        """Return True if the move ended at once, because the daemon did not play it.

        In that case another client's move runs. It was begun over a WebSocket, so no list contains it.
        """
        with trio.move_on_after(OVER_S):
            return (await self.ended(uuid)).event_type == p.COMPLETED
        return False

    async def ended(self, uuid: str) -> p.Update:
        while uuid not in self._ended:
            await self._end_received.wait()
        return self._ended[uuid]


class _NotedPermit:
    """A permit, the last check before a request is sent, that remembers its success. After ``passed`` is True
    the request may have been sent."""

    def __init__(self, permit: Permit) -> None:
        self._permit = permit
        self.passed = False

    def check(self) -> None:
        """Check that the request may be sent. Raise ``PermitDenied``."""
        self._permit.check()
        self.passed = True


class Services:
    """Run one service at a time.

    Attributes:
        unanswered: Set when the request for motion or torque is answered; None if no answer is outstanding.
        unanswered_port: The connection of that request, while it is outstanding.
        abandoned: Why the wait for an answer has ended; empty otherwise. The request may still take effect, so
            the link has to end.
    """

    def __init__(self, config: ReachyConfig, host: str, number: int, moves: Moves) -> None:
        self._config = config
        self._address = host, number
        self._moves = moves
        self.unanswered: trio.Event | None = None
        self.unanswered_port: HttpPort | None = None
        self.abandoned = ""

    async def perform(
        self, service: str, arguments: Mapping[str, Any], permit: Permit, observation: Observation
    ) -> dict[str, Any] | Refused:
        """Run a service. Raise ``WireDown`` or ``PermitDenied``."""
        client = HttpPort(*self._address)
        try:
            answer = await self._perform(client, service, arguments, permit, observation)
            # If a stop has ended the effect of this service, do not report success.
            await trio.lowlevel.checkpoint_if_cancelled()
            return answer
        except MalformedFrame as malformed:
            raise WireDown(f"the daemon sent an invalid answer: {malformed}. Check the daemon") from None
        finally:
            client.close()

    async def _perform(
        self, client: HttpPort, service: str, arguments: Mapping[str, Any], permit: Permit, observation: Observation
    ) -> dict[str, Any] | Refused:
        match ALSO.get(service, service):
            case "wake":
                return await self._move(client, p.WAKE_UP, b"", permit)
            case "sleep":
                return await self._move(client, p.GOTO_SLEEP, b"", permit)
            case "express":
                return await self._express(client, arguments["move"], arguments.get("dataset", p.DATASET), permit)
            case "turn_to_sound":
                return await self._turn_to_sound(client, permit, observation)
            case "turn_to_sound_status":
                return await self._sound(client)
            case "list_moves":
                names = await self._names(client, arguments.get("dataset", p.DATASET))
                return names if isinstance(names, Refused) else {"moves": names}
            case "motors":
                return await self._switch(client, arguments.get("mode", "enabled"), permit)
            case "say":
                return await self._say(client, arguments["text"], permit)
            case "play_sound":
                body = msgspec.json.encode({"file": arguments["file"]})
                return await self._post(client, p.PLAY_SOUND, body, permit, {"playing": arguments["file"]})
            case "set_volume":
                volume = int(arguments.get("volume", 50))
                body = msgspec.json.encode({"volume": volume})
                return await self._post(client, p.SET_VOLUME, body, permit, {"volume": volume})
            case "track_face":
                return await self._track(client, arguments, permit)
            case "camera":
                answer = await self._get(client, p.CAMERA)
                host = self._address[0]
                host = f"[{host}]" if ":" in host else host
                stream = f"ws://{host}:{self._config.media_port}"
                return answer if isinstance(answer, Refused) else {**p.decode_object(answer), "webrtc": stream}
        target = {"volume": p.VOLUME, "tracking_status": p.TRACKED_FACE}[service]
        answer = await self._get(client, target)
        return answer if isinstance(answer, Refused) else p.decode_object(answer)

    async def _move(self, client: HttpPort, target: str, body: bytes, permit: Permit) -> dict[str, Any] | Refused:
        """Begin a move and wait for its end. Our own running move is ended first. The daemon would ignore the
        new move while another client's move runs, so it is refused then."""
        running = await client.ask("GET", p.RUNNING, within_s=BEGIN_S)
        if running.status != p.OK:
            return refusals.daemon_error(running.status, running.body)
        if self._moves.has_foreign(p.decode_running(running.body)):
            return refusals.ignored()
        if self._moves.running:
            stop = p.encode_uuid(self._moves.running)
            await client.ask("POST", p.STOP, stop, within_s=ASK_S, permit=permit)
        answer = await self._energise(client, target, body, permit, BEGIN_S)
        if answer.status != p.OK:
            return refusals.daemon_error(answer.status, answer.body)
        uuid = p.decode_move(answer.body)
        self._moves.begin(uuid)
        if await self._moves.ignored(uuid):
            return refusals.ignored()
        end = await self._moves.ended(uuid)
        if end.event_type != p.COMPLETED:
            return refusals.move_ended_early(end.event_type, end.details)
        return {"move": uuid}

    async def _energise(
        self, client: HttpPort, target: str, body: bytes, permit: Permit, within_s: float
    ) -> Response:
        """Send a request for motion or torque, and wait for its answer.

        A stop does not cancel this wait. The stop must know whether a motion has begun, and whether the request
        may still take effect.
        """
        answered, noted = trio.Event(), _NotedPermit(permit)
        self.unanswered, self.unanswered_port = answered, client
        try:
            with trio.CancelScope(shield=True):
                answer = await client.ask("POST", target, body, within_s=within_s, permit=noted)
        except WireDown as down:
            if noted.passed:
                self.abandoned = str(down)
            raise
        finally:
            self.unanswered = self.unanswered_port = None
            answered.set()
        return answer

    async def _switch(self, client: HttpPort, mode: str, permit: Permit) -> dict[str, Any] | Refused:
        answer = await self._energise(client, f"{p.SET_MODE}{mode}", b"", permit, SWITCH_S)
        if answer.status != p.OK:
            return refusals.daemon_error(answer.status, answer.body)
        return {"mode": mode}

    async def _express(self, client: HttpPort, move: str, dataset: str, permit: Permit) -> dict[str, Any] | Refused:
        """Play a recorded move. First request the list of moves, so that the daemon downloads the dataset.
        Otherwise the move would begin late."""
        names = await self._names(client, dataset)
        if isinstance(names, Refused):
            return names
        if move not in names:
            return refusals.no_such_move(dataset, move, ", ".join(names)[:200])
        return await self._move(client, f"{p.PLAY}{dataset}/{move}", b"", permit)

    async def _names(self, client: HttpPort, dataset: str) -> list[str] | Refused:
        answer = await client.ask("GET", f"{p.LIST_MOVES}{dataset}", within_s=FETCH_S)
        if answer.status != p.OK:
            return refusals.daemon_error(answer.status, answer.body)
        return p.decode_names(answer.body)

    async def _turn_to_sound(
        self, client: HttpPort, permit: Permit, observation: Observation
    ) -> dict[str, Any] | Refused:
        sound = await self._sound(client)
        if isinstance(sound, Refused):
            return sound
        row = list(observation.position)
        left_deg = sound["left_deg"]
        # The microphones turn with the head [assumed].
        row[p.YAW] += left_deg
        apart = row[p.YAW] - row[p.BODY]
        limit = self._config.yaw_deg
        if abs(apart) > limit or abs(row[p.YAW]) > 180.0:
            return refusals.sound_out_of_reach(apart, limit)
        duration_s = max(SHORTEST_S, abs(left_deg) / TURN_DEG_S / EASE)
        moved = await self._move(client, p.GOTO, p.encode_goto(row, duration_s), permit)
        return moved if isinstance(moved, Refused) else {**sound, "head_yaw": row[p.YAW]}

    async def _sound(self, client: HttpPort) -> dict[str, Any] | Refused:
        body = await self._get(client, p.DIRECTION_OF_SOUND)
        if isinstance(body, Refused):
            return body
        sound = p.decode_direction(body)
        if sound is None:
            return refusals.no_direction_of_sound()
        return {"left_deg": sound[0], "speech": sound[1]}

    async def _track(
        self, client: HttpPort, arguments: Mapping[str, Any], permit: Permit
    ) -> dict[str, Any] | Refused:
        if not arguments.get("enabled", True):
            return await self._post(client, p.TRACKING_OFF, b"", permit, {"tracking": False})
        body = msgspec.json.encode({"weight": float(arguments.get("weight", 1.0))})
        answer = await self._energise(client, p.TRACKING_ON, body, permit, BEGIN_S)
        if answer.status != p.OK:
            return refusals.daemon_error(answer.status, answer.body)
        if p.decode_object(answer.body).get("enabled") is not True:
            return refusals.no_camera()
        return {"tracking": True}

    async def _say(self, client: HttpPort, text: str, permit: Permit) -> dict[str, Any] | Refused:
        host, number, target = parse_speech_url(self._config.tts_url)
        speech = HttpPort(host, number, max_body=SPEECH_SIZE)
        try:
            made = await speech.ask("POST", target, msgspec.json.encode({"text": text}), within_s=SPEECH_S)
        finally:
            speech.close()
        if made.status != p.OK or not made.body.startswith(b"RIFF"):
            return refusals.no_speech(made.status)
        form = (
            f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="file"; filename="{SPEECH}"\r\n'
            "Content-Type: audio/wav\r\n\r\n"
        )
        body = form.encode() + made.body + f"\r\n--{BOUNDARY}--\r\n".encode()
        content_type = f"multipart/form-data; boundary={BOUNDARY}"
        upload = await client.ask(
            "POST", p.UPLOAD_SOUND, body, within_s=ASK_S, permit=permit, content_type=content_type
        )
        if upload.status != p.OK:
            return refusals.daemon_error(upload.status, upload.body)
        play = msgspec.json.encode({"file": SPEECH})
        return await self._post(client, p.PLAY_SOUND, play, permit, {"said": text})

    async def _get(self, client: HttpPort, target: str) -> bytes | Refused:
        answer = await client.ask("GET", target, within_s=ASK_S)
        if answer.status == p.OK:
            return answer.body
        return refusals.daemon_error(answer.status, answer.body)

    async def _post(
        self, client: HttpPort, target: str, body: bytes, permit: Permit, done: dict[str, Any]
    ) -> dict[str, Any] | Refused:
        answer = await client.ask("POST", target, body, within_s=ASK_S, permit=permit)
        return done if answer.status == p.OK else refusals.daemon_error(answer.status, answer.body)
