"""Streams that cause no vibration: calls, alerts, and what the user leaves out. Pure functions."""

from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase

from device.server.app_rules import Rule, first_match
from device.server.snapshot import ServerSnapshot, Stream

CALL, ALERT, IN_CONFIG = "call", "alert", "left out in the config"
MIXED = "call, perhaps with other sounds of the browser"
REASONS = (CALL, MIXED, ALERT, IN_CONFIG)

FILM_LATENCY_S = 0.020  # browsers request 10 to 19 ms for a call, and 21 to 75 ms for a film

# Values of media.role. PulseAudio writes "phone" and "event"; PipeWire writes capitals.
_ROLES = dict.fromkeys(("communication", "phone"), CALL)
_ROLES |= dict.fromkeys(("notification", "event", "accessibility", "a11y"), ALERT)
# Names or binaries of voice programs, as patterns of a shell in lower case.
_VOICE_PROGRAMS = (
    "discord*", "webrtc voiceengine", "vesktop", "mumble*", "teamspeak*", "ts3client*",
    "zoom", "zoom voiceengine", "zoom.real", "teams", "teams-for-linux", "microsoft teams*",
)  # fmt: skip


@dataclass(frozen=True)
class LeftOut:
    """Decides which streams cause no vibration.

    rules: the user's, each with whether its streams are felt. calls_and_alerts: whether these are.
    """

    rules: tuple[tuple[Rule, bool], ...] = ()
    calls_and_alerts: bool = False

    def why(self, stream: Stream, microphones: Iterable[Stream]) -> str:
        """Return CALL, MIXED, ALERT or IN_CONFIG for a stream that is left out, otherwise "".

        microphones: all streams that record from microphones.
        """
        if (feel := first_match(self.rules, stream)) is False:
            return IN_CONFIG
        if feel or self.calls_and_alerts:
            return ""
        if role := _ROLES.get(stream.role.casefold()):
            return role
        names = (stream.application.casefold(), stream.binary.casefold())
        if any(fnmatchcase(name, one) for name in names for one in _VOICE_PROGRAMS):
            return CALL
        # the latency that the stream requests from PipeWire, 0 if unknown
        frames, _, rate_hz = stream.properties.get("node.latency", "").partition("/")
        known = frames.isdecimal() and rate_hz.isdecimal() and int(rate_hz) > 0
        requested_s = int(frames) / int(rate_hz) if known else 0.0
        if stream.role or requested_s >= FILM_LATENCY_S:
            return ""
        return next(filter(None, (_browser_call(stream, one) for one in microphones)), "")

    def of(self, snapshot: ServerSnapshot) -> frozenset[int]:
        """Return the indexes of the playing streams that are left out."""
        microphones = microphones_of(snapshot)
        return frozenset(one.index for one in snapshot.sink_inputs if self.why(one, microphones))


ROLES_ONLY = LeftOut()  # leaves out calls and alerts


def microphones_of(snapshot: ServerSnapshot) -> tuple[Stream, ...]:
    """Return the streams that record from a source other than a sink's monitor."""
    monitors = {one.index for one in snapshot.sources if one.monitor_of is not None}
    return tuple(
        stream
        for stream in snapshot.source_outputs
        if stream.device_index is not None and stream.device_index not in monitors
    )


def _browser_call(stream: Stream, microphone: Stream) -> str:
    """Return CALL or MIXED if one browser makes both streams for the same page.

    Firefox names both streams after the tab. Chromium records by a second client. While it cancels
    echoes, Chromium plays all its sounds in one stream.
    """
    if stream.process_id != microphone.process_id:
        return ""
    if microphone.application == f"{stream.application} input":
        return MIXED
    one = (stream.application, stream.media)
    return CALL if one == (microphone.application, microphone.media) else ""
