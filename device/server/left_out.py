"""Streams that cause no vibration: calls, alerts, and what the user leaves out. Pure functions."""

from collections.abc import Set
from dataclasses import dataclass
from fnmatch import fnmatchcase

from device.server.app_rules import Rule, first_match
from device.server.snapshot import ServerSnapshot, Stream

CALL, ALERT, IN_CONFIG = "call", "alert", "left out in the config"

# Values of media.role. PulseAudio writes "phone" and "event"; PipeWire writes capitals.
_ROLES = {
    "communication": CALL,
    "phone": CALL,
    "notification": ALERT,
    "event": ALERT,
    "accessibility": ALERT,
    "a11y": ALERT,
}
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

    def why(self, stream: Stream, *, records: bool) -> str:
        """Return CALL, ALERT or IN_CONFIG for a stream that is left out, otherwise "".

        records: whether the stream's client records from a microphone at the same time.
        """
        feel = first_match(self.rules, stream)
        if feel is False:
            return IN_CONFIG
        if feel or self.calls_and_alerts:
            return ""
        if role := _ROLES.get(stream.role.casefold()):
            return role
        names = (stream.application.casefold(), stream.binary.casefold())
        known = any(fnmatchcase(name, one) for name in names for one in _VOICE_PROGRAMS)
        return CALL if known or records else ""


ROLES_ONLY = LeftOut()  # leaves out calls and alerts


def client_of(stream: Stream) -> str:
    """Return the id of the client that owns a stream, "" if unknown."""
    return stream.properties.get("client.id", "")


def recording_clients(snapshot: ServerSnapshot) -> Set[str]:
    """Return the ids of clients that record from a source other than a sink's monitor."""
    monitors = {one.index for one in snapshot.sources if one.monitor_of is not None}
    return {
        client_of(stream)
        for stream in snapshot.source_outputs
        if stream.device_index is not None
        and stream.device_index not in monitors
        and client_of(stream)
    }
