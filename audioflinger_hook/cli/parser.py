"""The command line's grammar."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from audioflinger_hook import __version__
from audioflinger_hook.cli.arguments import (
    CONFIG_HELP,
    Parser,
    add_exporting,
    add_json,
    add_keys,
    add_profile,
    add_rendering,
    add_switch,
    add_value,
    count,
    duration,
    seconds,
)

NEXT = (
    "next: `cushion setup` leads through the first run, `cushion demo` plays a scene, and "
    "`cushion run --device DEVICE` plays the vibration of everything"
)
DESCRIPTION = "Feel what a computer plays: sound in, vibration of 20-220 Hz out."
EXIT_CODES = (
    "exit codes: 0 done; 2 wrong usage, config or input; 3 no such tap or device, or no running "
    "daemon; 4 the sound server is missing, or server or device was lost; 5 internal error; disk "
    "full or write failure; 130 interrupted"
)

SEE_DEVICES = "see `cushion devices`"
SINKS = f"sink:NAME or usb:VID:PID; {SEE_DEVICES}"


AddOptions = Callable[[Parser], None]

COMMANDS: dict[str, tuple[AddOptions, str, str]] = {}
"""Every command: the function that adds its options, its help, and an example's arguments."""


def build_parser() -> Parser:
    """Return the parser; in the parsed options, `command` is the command's name."""
    parser = Parser(prog="cushion", description=DESCRIPTION, epilog=EXIT_CODES)
    add_switch(parser, "--debug", "show tracebacks")
    parser.add_argument("--version", action="version", version=f"cushion {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, (add_options, does, example) in COMMANDS.items():
        shown = f"example: cushion {name} {example}".rstrip()
        command = commands.add_parser(name, help=does, description=does, epilog=shown)
        command.add_options = add_options
        add_switch(command, "--debug", "show tracebacks")
    return parser


def _command(name: str, does: str, example: str = "") -> Callable[[AddOptions], AddOptions]:
    """Make a function that adds options a command; a module with its name has its `run`."""

    def register(add_options: AddOptions) -> AddOptions:
        COMMANDS[name] = (add_options, does, example)
        return add_options

    return register


@_command("setup", "lead through the first run")
def _setup(command: Parser) -> None:
    add_switch(command, "--yes", "ask nothing: take the options, and what is likely")
    add_value(command, "--device", str, "DEVICE", f"{SEE_DEVICES}; default: ask")
    named = "cinema, game, music, paper or speech-free; default: ask"
    add_value(command, "--profile", str, "NAME", named)
    add_switch(command, "--no-test", "play no tone")
    add_switch(command, "--no-service", "install no service")
    add_switch(command, "--undo", "restore what was before the last setup")


@_command("demo", "play the bundled scene through the whole chain", "--fast")
def _demo(command: Parser) -> None:
    add_value(command, "--out", Path, "DIR", "folder to write to", Path("out"))
    add_profile(command, live=True)
    add_keys(command, "model", "tolerance")
    add_switch(command, "--fast", "do not wait for real time")


@_command("render", "write the vibration of sound files", "film.wav vibration.wav --profile cinema")
def _render(command: Parser) -> None:
    command.usage = "%(prog)s [options] IN OUT\n       %(prog)s [options] --out-dir DIR IN..."
    # IN and OUT are parsed as one list; `cli.render` checks its length.
    command.any_order = True
    files = "a sound file; a float32 WAV to write"
    command.add_argument("files", nargs="*", type=Path, metavar="IN OUT", help=files)
    add_value(command, "--out-dir", Path, "DIR", "write DIR/IN.wav for every IN, several at once")
    add_value(command, "--workers", count, "N", "processes at once; default: the usable cores")
    add_rendering(command)


@_command(
    "export",
    "write the vibration in a format of other haptic tools",
    "film.wav film.ahap --device-band 80:230",
)
def _export(command: Parser) -> None:
    command.add_argument("input", type=Path, metavar="IN", help="a sound file")
    command.add_argument("output", type=Path, metavar="OUT", help="the file to write")
    add_exporting(command, "by OUT's ending", None)


@_command(
    "catalogue",
    "write the vibration of whole libraries",
    "music --out vibration --format flac --output-rate 1000",
)
def _catalogue(command: Parser) -> None:
    command.usage = "%(prog)s [status] MANIFEST --out URL [options]"
    command.any_order = True  # `status` and MANIFEST are parsed as one list
    sounds = "JSON lines or CSV, a folder or a glob; path or URL. status: show what is done"
    command.add_argument("words", nargs="*", metavar="[status] MANIFEST", help=sounds)
    add_value(command, "--out", str, "URL", "folder of the results, path or URL")
    add_value(command, "--workers", count, "N", "processes at once; default: the usable cores")
    add_value(command, "--shard", str, "I/N", "take one of N equal shares; I is 1 to N")
    add_value(command, "--dask", str, "ADDRESS", "use a Dask cluster; local: one of this machine")
    add_value(command, "--max-failures", count, "N", "stop after more; default: never")
    add_value(command, "--retries", count, "N", "repetitions of failed I/O", 3)
    add_switch(command, "--verify", "know sounds by their SHA-256, not by path, size and time")
    add_value(command, "--track", count, "N", "sound track of films; default: the film's")
    add_value(command, "--language", str, "CODE", "language of the films' sound track, such as eng")
    add_value(command, "--report", Path, "DIR", "write a page with a picture of each item")
    add_exporting(command, "wav", "wav")


@_command("inspect", "list the principal frequencies of a sound file", "film.wav --at 12.5")
def _inspect(command: Parser) -> None:
    command.add_argument("input", type=Path, metavar="IN", help="a sound file")
    add_value(command, "--at", seconds, "SECONDS", "list only the unit at that time")
    add_json(command)


def _add_stop(command: Parser, default: str) -> None:
    stop = f"stop after S seconds; default: {default}"
    command.add_argument("--seconds", type=duration, default=math.inf, metavar="S", help=stop)


@_command("capture", "record the buffers of a sound as delivered", "recorded --seconds 10")
def _capture(command: Parser) -> None:
    command.add_argument("folder", type=Path, metavar="OUTDIR", help="a new or empty folder")
    taps = "default, sink:NAME, file:PATH, capture:DIR or scene:demo"
    add_value(command, "--tap", str, "TAP", taps, "default")
    _add_stop(command, "when the sound ends")


@_command("replay", "write the vibration of a capture", "recorded vibration.wav")
def _replay(command: Parser) -> None:
    command.add_argument("folder", type=Path, metavar="DIR", help="a capture")
    command.add_argument("output", type=Path, metavar="OUT", help="float32 WAV to write")
    add_value(command, "--speed", str, "1|max", "real time, or as fast as possible", "max")
    add_rendering(command)


@_command("dump", "show threads, tracks, effects and counters", "--tap file:film.wav --at 2")
def _dump(command: Parser) -> None:
    add_value(command, "--tap", str, "TAP", "file:PATH, capture:DIR or scene:demo", "scene:demo")
    add_value(command, "--at", seconds, "SECONDS", "how much sound to play first; default: 1")
    add_value(command, "--config", Path, "FILE", CONFIG_HELP)


@_command(
    "run",
    "play vibration of everything that this computer plays",
    "--device usb:152a:8750 --profile cinema",
)
def _run(command: Parser) -> None:
    add_keys(command, "tap", action="append")
    add_keys(command, "device")
    add_value(command, "--record", Path, "DIR", "record the run in a new folder")
    add_keys(command, "drop_in", "engine")
    add_value(command, "--config", Path, "FILE", "default: ~/.config/cushion/config.toml")
    _add_stop(command, "never")
    add_keys(command, "offset_ms", "device_volume_db")
    add_profile(command, live=True)
    add_keys(command, "rig", "damping", "protection", "model", "tolerance")
    add_switch(command, "--wait", "wait until server, device and tap are available")


@_command("status", "show the state of the running daemon", "--watch")
def _status(command: Parser) -> None:
    add_switch(command, "--watch", "repeat until interrupted")
    add_json(command)


@_command("monitor", "serve the live page of the running daemon", "--open")
def _monitor(command: Parser) -> None:
    add_value(command, "--listen", str, "HOST:PORT", "address to serve at", "127.0.0.1:8765")
    add_switch(command, "--open", "open it in a browser")
    add_value(command, "--rate", float, "HZ", "frames a second, 1 to 60", 30.0)


@_command("devices", "list outputs and playing applications")
def _devices(command: Parser) -> None:
    add_json(command)


@_command("usb", "decode a USB audio device, or a dump of one", "describe usb:152a:8750")
def _usb(command: Parser) -> None:
    does = "describe: show formats; set: set volume, samplerate and mute, without a driver"
    command.add_argument("does", choices=("describe", "set"), metavar="describe|set", help=does)
    names = "usb:VID:PID[:SERIAL][@PORT]; default: all"
    command.add_argument("device", nargs="?", metavar="DEVICE", help=names)
    add_value(command, "--hex", Path, "FILE", "decode a file: raw, lsusb -v or hex; - is stdin")
    taken = "also read volumes and sample rates; the card cannot play in that time"
    add_switch(command, "--take-over", taken)
    add_value(command, "--volume-db", float, "DB", "set: volume, up to 0")
    add_value(command, "--samplerate", count, "HZ", "set: samplerate")
    command.add_argument("--mute", choices=("on", "off"), metavar="on|off", help="set: mute")
    add_json(command)


@_command(
    "test-tone", "play a tone on one output, to find the right one", "--device sink:NAME --hz 50"
)
def _test_tone(command: Parser) -> None:
    command.add_argument("--device", required=True, metavar="DEVICE", help=SINKS)
    add_value(command, "--hz", float, "HZ", "frequency", 60.0)
    add_value(command, "--level", float, "L", "amplitude, up to 1", 0.2)
    add_value(command, "--seconds", float, "S", "duration", 2.0)


@_command("calibrate", "identify a rig with sweeps of rising level", "--device twin --out rig.toml")
def _calibrate(command: Parser) -> None:
    devices = f"{SEE_DEVICES}; or twin"
    command.add_argument("--device", required=True, metavar="DEVICE", help=devices)
    inputs = "input that records: source:NAME or hw:CARD[,DEVICE]"
    add_value(command, "--input", str, "INPUT", inputs)
    channels = "input channels in order: acceleration, current, voltage, loopback, or -"
    add_value(command, "--channels", str, "A,B,...", channels)
    add_value(command, "--input-full-scale-v", float, "V", "peak volts at the input's full scale")
    sensitivity = "sensitivity of the accelerometer"
    add_value(command, "--acceleration-mv-per-m-s2", float, "MV", sensitivity)
    add_value(command, "--shunt-ohm", float, "OHM", "resistance of the shunt resistor, up to 10")
    ratio = "volts at the coil per volt at the input"
    add_value(command, "--voltage-ratio", float, "X", ratio, 1.0)
    add_value(command, "--moving-mass-kg", float, "KG", "moving mass, if it was weighed; gives Bl")
    add_value(command, "--output-channel", int, "N", "output channel to play on, from 1", 1)
    add_value(command, "--level", float, "L", "part of full scale, up to 0.25; default: 0.05")
    add_switch(command, "--loud", "allow a --level up to 1")
    add_value(command, "--rig", str, "NAME|FILE", "known values of the rig", "paper")
    add_switch(command, "--seat", "simulated rig: mount it in a seat")
    share = "simulated rig: part of Xmax, up to 0.15; default: 0.05"
    add_value(command, "--share", float, "S", share)
    add_value(command, "--low-hz", float, "HZ", "lowest frequency", 15.0)
    add_value(command, "--high-hz", float, "HZ", "highest frequency", 400.0)
    add_value(command, "--seconds", duration, "S", "duration of each sweep", 5.0)
    add_value(command, "--out", Path, "FILE", "rig file to write")
    add_json(command)


@_command(
    "plugin", "install the effect as a plugin of other audio software", "install --device NODE"
)
def _plugin(command: Parser) -> None:
    from audioflinger_hook.config.profiles import LIVE_DEFAULT, PROFILES

    does = "print where it is; write it with its settings for this user; remove it"
    verbs = ("path", "install", "remove")
    command.add_argument("does", choices=verbs, metavar="|".join(verbs), help=does)
    command.add_argument(
        "--profile",
        choices=tuple(PROFILES),
        default=LIVE_DEFAULT,
        metavar="NAME",
        help=f"of the PipeWire chain: {', '.join(PROFILES)}; default: {LIVE_DEFAULT}",
    )
    chain = "also write a PipeWire chain that plays to this sink"
    add_value(command, "--device", str, "NODE", chain)
    add_value(command, "--rate", int, "HZ", "also write settings for this sample rate")


@_command("install-service", "start the daemon at every login", "--device usb:152a:8750")
def _install_service(command: Parser) -> None:
    add_value(command, "--device", str, "DEVICE", f"{SEE_DEVICES}; default: the config's")
    add_value(command, "--tap", str, "TAP", "where the sound comes from; default: the config's")
    add_switch(command, "--remove", "remove the unit")
    add_switch(command, "--udev", "print a rule for USB devices; without a device, only that")


@_command("check", "report every mistake of a config file", "--config config.toml")
def _check(command: Parser) -> None:
    add_value(command, "--config", Path, "FILE", "default: ~/.config/cushion/config.toml")
    add_switch(command, "--schema", "print the JSON Schema of the config, for editors")
    add_json(command)
