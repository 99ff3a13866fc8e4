"""`cushion setup`: guides through the first run, and writes the config and the service.

It asks all questions before it writes a file. If it fails, it restores the earlier files.
"""

import argparse
import difflib
import sys
import tomllib
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from audioflinger_hook.cli import setup_files
from audioflinger_hook.cli.outputs import COILS, SOUND, SURROUND, Output, list_outputs, shaker_pair
from audioflinger_hook.cli.terminal import agree, as_typed, name_some, pick, warn
from audioflinger_hook.cli.test_tone import PCM, try_output
from audioflinger_hook.config import file as config
from audioflinger_hook.config.edits import actuator_text, commented_text, edited_text, value_in
from audioflinger_hook.config.profiles import LIVE_DEFAULT, PROFILES
from audioflinger_hook.service import autostart
from audioflinger_hook.service import install as service
from device.address import DeviceAddress, parse_device
from device.alsa import find_playback, list_cards
from device.alsa.cards import list_devices
from device.drive import ActuatorSettings
from device.errors import LostError, NotFoundError, UsageError
from device.server import PulseConnection, ServerSnapshot
from device.stream import PcmConfig, filter_stderr
from device.stream.pcms import missing_plugin
from device.usb import find_devices
from device.values import Choice

SPEECH_FREE = "speech-free"
SPEECH_KEY, SPEECH_SUPPRESSION_DB = "transform.speech_suppression_db", 12.0

PLAYED = {  # what users play, keyed by profile
    "cinema": "films, and everything else",
    "game": "games",
    "music": "music",
    SPEECH_FREE: "films and talk, with speech left out",
}

NOTHING_WRITTEN = "nothing was written"


def run(options: argparse.Namespace) -> int:
    """Ask the questions, write the files, print the next commands; or undo the last setup."""
    if options.undo:
        done, commands = setup_files.undo()
        print(*done, sep="\n")
        if commands:
            print("next, type:", *commands, sep="\n    ")
        return 0
    if not options.yes and not sys.stdin.isatty():
        raise UsageError(
            "setup asks questions, but its input is not a terminal; give the answers: "
            "`cushion setup --yes --device DEVICE --profile NAME`"
        )
    path = config.default_path()
    before = setup_files.text_of(path)
    wired: tuple[ActuatorSettings, ...] = ()
    if before is not None:  # the user must repair a config with mistakes first
        wired = config.load(path, LIVE_DEFAULT).settings.actuators
    known = Choice("what is played", (*PROFILES, SPEECH_FREE))
    if options.profile is not None and (refusal := known.refuse(options.profile)):
        raise UsageError(f"profile={options.profile!r} {refusal}")
    has_service = not options.no_service and autostart.is_on()
    choice = _chosen(options, wired)
    if choice is None:
        print(f"The tone was stopped; {NOTHING_WRITTEN}.")
        return 0
    address, level_db, channels = choice
    values: dict[str, Any] = {"device": address}
    if level_db is not None:
        values["gain_db"] = level_db
    values |= _profile_values(options.profile or _ask_profile(options.yes, before), before)
    text = _new_text(path, before, values, channels)
    if text == before:
        print(f"\n{path} has these settings already.")
    else:
        print(f"\n{path} will {'be' if before is None else 'change'}:")
        if before is None:
            lines = [line for line in text.splitlines() if line and not line.startswith("#")]
        else:
            old, new = before.splitlines(), text.splitlines()
            lines = [*difflib.unified_diff(old, new, lineterm="", n=1)][2:]
        print("".join(f"  {line}\n" for line in lines), end="")
        if not options.yes and not agree("Write it?", default=before is None):
            print(f"{path} is unchanged; {NOTHING_WRITTEN}.")
            return 0
    installs = not options.no_service and (
        options.yes or agree("Start the daemon at every login?", default=True)
    )
    backup = setup_files.write(path, before, text, with_service=installs)
    if text != before:
        print(f"\n{path} is written.{f' The earlier file is {backup}.' if backup else ''}")
    _tell(path, text, installs or has_service)
    return 0


def _chosen(
    options: argparse.Namespace, wired: tuple[ActuatorSettings, ...]
) -> tuple[str, float | None, tuple[str, ...]] | None:
    """Return the chosen output's address, level and channels; None if the user stopped the tone.

    The level is that at which the user felt the tone, None if not asked. Without channels, all
    drive actuators, or those of the config. wired: the config's actuators.
    """
    filter_stderr()
    named = None if options.device is None else parse_device(options.device)
    with ExitStack() as stack:
        pcms = stack.enter_context(closing(PcmConfig(PCM)))
        connection = stack.enter_context(closing(PulseConnection()))
        on_server = named is None or named.kind != "hw"
        if on_server and not options.no_test and (missing := missing_plugin()):
            raise NotFoundError(missing)
        while True:
            playbacks = [each for card in list_cards() for each in list_devices(card)]
            outputs = list_outputs(connection.latest, find_devices().devices, playbacks)
            if named is not None:
                output = _named(named, outputs, connection.latest)
            else:
                output = _first(outputs) if options.yes else _ask_output(outputs)
            _warn_of_sound(output, options.yes, named is not None)
            channels = () if wired or options.yes else _ask_channels(output)
            felt, level_db = "yes", None
            if not options.no_test:
                actuators = (ActuatorSettings(channels),) if channels else wired
                device = parse_device(output.address)
                try:
                    felt, level_db = try_output(
                        device, pcms.pcms[PCM], connection, actuators, ask=not options.yes
                    )
                except (LostError, NotFoundError, UsageError) as error:
                    if options.yes or named is not None:
                        raise
                    felt = "no"
                    print(error)
            if felt == "yes":
                return output.address, level_db, channels
            if felt == "stop":
                return None
            if named is not None:
                raise NotFoundError(
                    f"you reported no vibration from {output.address}, and {NOTHING_WRITTEN}; "
                    "check its amplifier and cables, or name another --device"
                )
            connection.snapshot()


def _named(device: DeviceAddress, outputs: list[Output], snapshot: ServerSnapshot) -> Output:
    if device.kind not in ("sink", "usb", "hw"):
        allowed = "sink:NAME, usb:VID:PID, hw:CARD"
        raise UsageError(f"device {str(device)!r} cannot be used by setup; allowed: {allowed}")
    if device.kind == "hw":
        find_playback(device.name)
    else:
        sink = device.sink(snapshot)
        for output in outputs:
            listed = parse_device(output.address)
            if listed.kind != "hw" and listed.sink(snapshot) == sink:
                return replace(output, address=str(device))
    return Output(str(device), device.name, 0, "the named output")


def _first(outputs: list[Output]) -> Output:
    """Return the only output known to have voice coils. UsageError: there are none or several."""
    sure = [output for output in outputs if output.rank == COILS]
    if len(sure) == 1:
        return sure[0]
    names = ", ".join(output.address for output in outputs) or "none is connected"
    raise UsageError(
        "--yes chooses an output only if exactly one is known to have voice coils; name one with "
        f"--device: {names}"
    )


def _ask_output(outputs: list[Output]) -> Output:
    if not outputs:
        raise NotFoundError("there is no output; connect a sound card, then run setup again")
    print("Where is the shaker, exciter or controller connected?")
    items = [f"{o.description or o.address}\n     {o.address}: {o.note}" for o in outputs]
    return outputs[pick("Output:", items, 0 if outputs[0].rank <= SURROUND else None)]


def _ask_channels(output: Output) -> tuple[str, ...]:
    """Return the channels that drive actuators; empty: all, or those known to have coils."""
    if len(output.positions) < 4 or output.has_coils:
        return ()
    print(f"The output has the channels {', '.join(output.positions)}.")
    pair = ",".join(shaker_pair(output.positions))
    return name_some(f"Which drive shakers? all, or some, such as {pair}:", output.positions)


def _warn_of_sound(output: Output, yes: bool, named: bool) -> None:
    """Warn if the output plays the computer's sound. NotFoundError: it is not accepted."""
    if output.rank != SOUND:
        return
    heard = (
        f"{output.address} plays the computer's sound, so vibration would be heard there; "
        "`cushion run` needs another default output, or an application as --tap"
    )
    if yes and named:
        warn(heard)
        return
    print(f"{heard}.")
    if yes or not agree("Use it anyway?", default=False):
        raise NotFoundError(
            f"no output for vibration was chosen, and {NOTHING_WRITTEN}; connect a USB sound card "
            "or a controller, then run setup again"
        )


def _ask_profile(yes: bool, before: str | None) -> str:
    if yes:
        return "" if before is not None else LIVE_DEFAULT
    print("\nWhat do you play most?")
    profiles = list(PLAYED)
    return profiles[pick("Played:", [f"{PLAYED[name]} ({name})" for name in profiles], 0)]


def _profile_values(profile: str, before: str | None = None) -> dict[str, Any]:
    """Return the config values of a profile; None removes the key. Profile "" has no values.

    before: the config's text. If `SPEECH_FREE` set a key in it, other profiles remove this key.
    """
    if profile == SPEECH_FREE:
        return {"profile": LIVE_DEFAULT, SPEECH_KEY: SPEECH_SUPPRESSION_DB}
    values: dict[str, Any] = {"profile": profile} if profile else {}
    if profile and before and value_in(_document(before), SPEECH_KEY) == SPEECH_SUPPRESSION_DB:
        values[SPEECH_KEY] = None
    return values


def _new_text(
    path: Path, before: str | None, values: dict[str, Any], channels: tuple[str, ...]
) -> str:
    """Return the config's new text. UsageError: the new text would be invalid."""
    if before is None:
        text = commented_text(values, channels)
    else:
        document = _document(before)
        changes = {name: new for name, new in values.items() if value_in(document, name) != new}
        text = edited_text(before, changes) if changes else before
        if channels:
            text = f"{text.rstrip()}\n\n{actuator_text(channels)}"
    _, mistakes = config.check_text(text, path.parent, LIVE_DEFAULT)
    if mistakes:
        raise UsageError(f"{path} would have a mistake: {mistakes[0]}; {NOTHING_WRITTEN}")
    return text


def _document(text: str) -> dict[str, Any]:
    return tomllib.loads(text.removeprefix("\ufeff"))


def _tell(path: Path, text: str, has_service: bool) -> None:
    found = config.check_text(text, path.parent, LIVE_DEFAULT)[0]
    assert found is not None
    settings = found.settings
    print(
        f"\nThe vibration of this computer's sound will go to {found.live.device}, with profile "
        f"{settings.profile} at {settings.gain_db:g} dB."
    )
    print("next, type:")
    by_systemd = has_service and autostart.has_systemd()
    plays = (as_typed("run"), "plays the vibration; Ctrl+C ends it")
    rows = [
        (service.START[-1], "") if by_systemd else plays,  # the service is enabled already
        (as_typed("monitor --open"), "opens a page that shows and adjusts the vibration"),
        (as_typed("status"), "shows the state of the daemon"),
        (as_typed("setup --undo"), "restores the config and the service as before"),
    ]
    width = max(24, 2 + max(len(command) for command, does in rows if does))
    for command, does in rows:
        print(f"    {command:<{width}}{does}".rstrip())
