"""`cushion devices`: sinks, what can be tapped, and which applications play."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from typing import Any

from rich.table import Table

from audioflinger_hook.cli.terminal import LineConsole, warn
from device.errors import CushionError
from device.server import PulseConnection, ServerSnapshot, identity_of, quiet_libraries
from device.server.identity import is_own


def run(options: argparse.Namespace) -> int:
    """List what is there; without a sound server say so, and end well."""
    quiet_libraries()
    try:
        connection = PulseConnection()
    except CushionError as error:
        warn(str(error))
        if options.json:
            print(json.dumps({"server": None, "sinks": [], "applications": []}))
        return 0
    try:
        snapshot = connection.latest
    finally:
        connection.close()
    document = _document(snapshot)
    if options.json:
        print(json.dumps(document, indent=2))
    else:
        _show(document)
    return 0


def _document(snapshot: ServerSnapshot) -> dict[str, Any]:
    names = {sink.index: sink.name for sink in snapshot.sinks}
    return {
        "server": f"{snapshot.kind} {snapshot.version}",
        "default_sink": snapshot.default_sink or None,
        "sinks": [
            {
                "name": sink.name,
                "device": f"sink:{sink.name}",
                "description": sink.description,
                "monitor": sink.monitor,
                "samplerate": sink.samplerate,
                "channels": sink.channels,
                "default": sink.name == snapshot.default_sink,
                "identity": asdict(identity_of(sink)),
            }
            for sink in snapshot.sinks
        ],
        "applications": [
            {
                "name": stream.application,
                "binary": stream.binary,
                "role": stream.role,
                "media": stream.media,
                "process_id": stream.process_id,
                "sink": names.get(stream.place) if stream.place is not None else None,
                "paused": stream.corked,
            }
            for stream in snapshot.sink_inputs
            if not is_own(stream)
        ],
    }


def _show(document: dict[str, Any]) -> None:
    console = LineConsole()
    sinks = Table("device", "description", "Hz", "channels", title=document["server"])
    for sink in document["sinks"]:
        mark = " (default)" if sink["default"] else ""
        sinks.add_row(
            sink["device"] + mark,
            sink["description"],
            str(sink["samplerate"]),
            str(sink["channels"]),
        )
    console.print(sinks)
    if document["applications"]:
        playing = Table("application", "binary", "role", "plays to", title="playing")
        for application in document["applications"]:
            playing.add_row(
                application["name"],
                application["binary"],
                application["role"],
                application["sink"] or "-",
            )
        console.print(playing)
