"""The commands of the command line, with their options and help texts."""

import math
from collections.abc import Callable
from pathlib import Path

from audioflinger_hook import __version__
from audioflinger_hook.cli.arguments import Parser, count, duration, seconds

NEXT = (
    "next: `cushion setup` guides through the first run, `cushion demo` plays a scene, and "
    "`cushion run --device DEVICE` plays the vibration of everything"
)
DESCRIPTION = "Feel what a computer plays: sound in, vibration of 20-220 Hz out."
EXIT_CODES = (
    "exit codes: 0 done; 1 doctor found something; 2 wrong usage, config or input; 3 no such tap "
    "or device, or no running daemon; 4 the sound server is missing, or server or device was lost; "
    "5 internal error, full disk or write failure; 130 interrupted"
)

SEE_DEVICES = "see `cushion devices`"
SINKS = f"sink:NAME or usb:VID:PID; {SEE_DEVICES}"


AddOptions = Callable[[Parser], None]

COMMANDS: dict[str, tuple[AddOptions, str, str]] = {}  # add options, help, example


def build_parser() -> Parser:
    """Return the parser of the command line. It stores the command's name as `command`."""
    parser = Parser(prog="cushion", description=DESCRIPTION, epilog=EXIT_CODES)
    parser.add_switch("--debug", "show tracebacks")
    parser.add_argument("--version", action="version", version=f"cushion {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, (add_options, does, example) in COMMANDS.items():
        shown = f"example: cushion {name} {example}".rstrip()
        command = commands.add_parser(name, help=does, description=does, epilog=shown)
        command.add_options = add_options
        command.add_switch("--debug", "show tracebacks")
    return parser


def _command(does: str, example: str = "") -> Callable[[AddOptions], AddOptions]:
    """Return a decorator that registers a command by the name of its function and its module."""

    def register(add_options: AddOptions) -> AddOptions:
        COMMANDS[add_options.__name__[1:].replace("_", "-")] = (add_options, does, example)
        return add_options

    return register


@_command("guide through the first run")
def _setup(command: Parser) -> None:
    command.add_switch("--yes", "ask no questions: use the given options and the defaults")
    command.add_value("--device", str, "DEVICE", f"{SEE_DEVICES}; default: ask")
    named = "cinema, game, music, speech, paper or speech-free; default: ask"
    command.add_value("--profile", str, "NAME", named)
    command.add_switch("--no-test", "play no tone")
    command.add_switch("--no-service", "install no service")
    command.add_switch("--undo", "restore the files as they were before the last setup")


@_command("play the bundled scene through the whole chain", "--fast")
def _demo(command: Parser) -> None:
    command.add_value("--out", Path, "DIR", "folder to write to", Path("out"))
    command.add_profile(live=True)
    command.add_keys("model", "tolerance")
    command.add_switch("--fast", "run as fast as possible, not in real time")


@_command("write the vibration of sound files", "film.wav vibration.wav --profile cinema")
def _render(command: Parser) -> None:
    command.usage = "%(prog)s [options] IN OUT\n       %(prog)s [options] --out-dir DIR IN..."
    # IN and OUT are parsed as one list; `cli.render` checks its length.
    command.any_order = True
    files = "a sound file; a float32 WAV to write"
    command.add_argument("files", nargs="*", type=Path, metavar="IN OUT", help=files)
    command.add_value("--out-dir", Path, "DIR", "write DIR/IN.wav for every IN, several at once")
    command.add_value("--workers", count, "N", "processes at once; default: the usable cores")
    command.add_rendering(acceleration=True)


@_command(
    "write the vibration in a format of other haptic tools",
    "film.wav film.ahap --device-band 80:230",
)
def _export(command: Parser) -> None:
    command.add_argument("input", type=Path, metavar="IN", help="a sound file")
    command.add_argument("output", type=Path, metavar="OUT", help="the file to write")
    command.add_exporting("by OUT's ending", None)


@_command(
    "write the vibration of whole libraries",
    "music --out vibration --format flac --output-rate 1000",
)
def _catalogue(command: Parser) -> None:
    command.usage = "%(prog)s [status] MANIFEST --out URL [options]"
    command.any_order = True  # `status` and MANIFEST are parsed as one list
    sounds = "JSON lines or CSV, a folder or a glob; path or URL. status: show the progress"
    command.add_argument("words", nargs="*", metavar="[status] MANIFEST", help=sounds)
    command.add_value("--out", str, "URL", "folder of the results, path or URL")
    command.add_value("--workers", count, "N", "processes at once; default: the usable cores")
    command.add_value("--shard", str, "I/N", "process only one of N equal shares; I is 1 to N")
    command.add_value("--dask", str, "ADDRESS", "use a Dask cluster; local: one of this machine")
    stop = "stop after more than N failures; default: never"
    command.add_value("--max-failures", count, "N", stop)
    command.add_value("--retries", count, "N", "retries of failed I/O", 3)
    command.add_switch("--retry-died", "try items again that ended their workers in an earlier run")
    command.add_switch("--verify", "identify sounds by SHA-256, not by path, size and time")
    command.add_value("--track", count, "N", "sound track of films; default: the film's")
    command.add_value("--language", str, "CODE", "language of the films' sound track, such as eng")
    command.add_value("--report", Path, "DIR", "write a page with a picture of each item")
    command.add_exporting("wav", "wav")


@_command("list the principal frequencies of a sound file", "film.wav --at 12.5")
def _inspect(command: Parser) -> None:
    command.add_argument("input", type=Path, metavar="IN", help="a sound file")
    command.add_value("--at", seconds, "SECONDS", "list only the unit at that time")
    command.add_json()


def _add_stop(command: Parser, default: str) -> None:
    stop = f"stop after S seconds; default: {default}"
    command.add_argument("--seconds", type=duration, default=math.inf, metavar="S", help=stop)


@_command("record the buffers of a sound as delivered", "recorded --seconds 10")
def _capture(command: Parser) -> None:
    command.add_argument("folder", type=Path, metavar="OUTDIR", help="a new or empty folder")
    taps = "default, sink:NAME, file:PATH, capture:DIR or scene:demo"
    command.add_value("--tap", str, "TAP", taps, "default")
    _add_stop(command, "when the sound ends")


@_command("write the vibration of a capture", "recorded vibration.wav")
def _replay(command: Parser) -> None:
    command.add_argument("folder", type=Path, metavar="DIR", help="a capture")
    command.add_argument("output", type=Path, metavar="OUT", help="float32 WAV to write")
    command.add_value("--speed", str, "1|max", "real time, or as fast as possible", "max")
    command.add_rendering(acceleration=True)


@_command("show threads, tracks, effects and counters", "--tap file:film.wav --at 2")
def _dump(command: Parser) -> None:
    command.add_value("--tap", str, "TAP", "file:PATH, capture:DIR or scene:demo", "scene:demo")
    command.add_value("--at", seconds, "SECONDS", "seconds of sound to play first; default: 1")
    command.add_config()


@_command(
    "play vibration of everything that this computer plays",
    "--device usb:152a:8750 --profile cinema",
)
def _run(command: Parser) -> None:
    command.add_keys("tap", action="append")
    command.add_keys("device")
    command.add_value("--record", Path, "DIR", "record the run in a new folder")
    command.add_keys("drop_in", "engine")
    command.add_value("--config", Path, "FILE", "default: ~/.config/cushion/config.toml")
    _add_stop(command, "never")
    command.add_keys("offset_ms", "device_volume_db")
    command.add_profile(live=True)
    command.add_keys("rig", "damping", "protection", "model", "tolerance")
    command.add_switch("--wait", "wait until server, device and tap are available")


@_command("show the state of the running daemon", "--watch")
def _status(command: Parser) -> None:
    command.add_switch("--watch", "repeat until interrupted; with --json, a line each second")
    command.add_json()


@_command("serve the live page of the running daemon", "--open")
def _monitor(command: Parser) -> None:
    command.add_value("--listen", str, "HOST:PORT", "address to serve at", "127.0.0.1:8765")
    command.add_switch("--open", "open it in a browser")
    command.add_value("--rate", float, "HZ", "updates of the page per second, 1 to 60", 30.0)


@_command("show a tray icon with on and off, strength and profile")
def _tray(_: Parser) -> None:
    pass


@_command("list outputs and playing applications")
def _devices(command: Parser) -> None:
    command.add_json()


@_command("decode a USB audio device, or a dump of one", "describe usb:152a:8750")
def _usb(command: Parser) -> None:
    does = "describe: show formats; set: set volume, samplerate and mute, without a driver"
    command.add_argument("does", choices=("describe", "set"), metavar="describe|set", help=does)
    names = "usb:VID:PID[:SERIAL][@PORT]; default: all"
    command.add_argument("device", nargs="?", metavar="DEVICE", help=names)
    command.add_value("--hex", Path, "FILE", "decode a file: raw, lsusb -v or hex; - is stdin")
    taken = "also read volumes and sample rates; the card cannot play meanwhile"
    command.add_switch("--take-over", taken)
    command.add_value("--volume-db", float, "DB", "set: volume, up to 0")
    command.add_value("--samplerate", count, "HZ", "set: samplerate")
    command.add_argument("--mute", choices=("on", "off"), metavar="on|off", help="set: mute")
    command.add_json()


@_command("play a tone on one output, to find the right one", "--device sink:NAME --hz 50")
def _test_tone(command: Parser) -> None:
    command.add_argument("--device", required=True, metavar="DEVICE", help=SINKS)
    command.add_value("--hz", float, "HZ", "frequency", 60.0)
    command.add_value("--level", float, "L", "amplitude, up to 1", 0.2)
    command.add_value("--seconds", float, "S", "duration", 2.0)


@_command("find the delay between sound and vibration")
def _sync(command: Parser) -> None:
    person = "ask a simulated person with this delay; SCATTER_MS: of its answers, default 15"
    command.add_value("--simulate", str, "MS[:SCATTER_MS]", person)
    command.add_value("--seed", count, "N", "seed of the random numbers; default: a new one")
    command.add_json()


@_command("make all frequencies feel equally strong to you", "--device sink:NAME")
def _fit(command: Parser) -> None:
    command.add_value("--device", str, "DEVICE", f"{SEE_DEVICES}; default: the daemon's")
    command.add_value("--name", str, "NAME", "name of the fit; default: from the device")
    command.add_value("--minutes", duration, "M", "at most 20 comparisons a minute, and 60", 3.0)
    command.add_switch("--page", "answer on a page, not by keys of the terminal")
    command.add_switch("--new", "begin again, and drop the answers of an interrupted fit")
    person = "let a simulated person answer; the file has its curve"
    command.add_value("--simulate", Path, "SITTER.json", person)
    command.add_value("--seed", count, "N", "seed of the order of trials; default: a new one")
    shown = "show fits and their differences from the first; default: all"
    command.add_argument("--show", nargs="*", metavar="NAME", help=shown)
    command.add_value("--undo", str, "NAME", "restore the fit before, or remove the only one")
    command.add_json()


@_command("design, run and report a study with people", "new first --design cinema")
def _study(command: Parser) -> None:
    does = "make a folder with a design; check and register it; let a person take part; report"
    actions = "new", "check", "run", "report"
    command.add_argument("action", choices=actions, metavar="|".join(actions), help=does)
    command.add_argument("folder", type=Path, metavar="NAME", help="the study's folder")
    designs = "of `new`: cinema, delay or identify"
    chosen = command.add_value("--design", str, "NAME", designs, "cinema")
    chosen.choices = ("cinema", "delay", "identify")
    command.add_value("--participant", str, "CODE", "of `run`: an anonymous code, such as P01")
    device = f"of `run`: {SEE_DEVICES}; default: the daemon's"
    command.add_value("--device", str, "DEVICE", device)
    people = "of `run`: people with known true parameters, in place of a person"
    command.add_value("--simulate", Path, "PEOPLE.json", people)
    command.add_switch("--no-power", "of `check`: do not simulate studies")
    command.add_value("--out", Path, "FILE", "of `report`: the page; default: NAME/report.html")
    command.add_json()


@_command("identify a rig with sweeps of rising level", "--device twin --out rig.toml")
def _calibrate(command: Parser) -> None:
    devices = f"{SEE_DEVICES}; or twin"
    command.add_argument("--device", required=True, metavar="DEVICE", help=devices)
    inputs = "input that records: source:NAME or hw:CARD[,DEVICE]"
    command.add_value("--input", str, "INPUT", inputs)
    channels = "input channels in order: acceleration, current, voltage, loopback, or -"
    command.add_value("--channels", str, "A,B,...", channels)
    command.add_value("--input-full-scale-v", float, "V", "peak volts at the input's full scale")
    command.add_value("--acceleration-mv-per-m-s2", float, "MV", "sensitivity of the accelerometer")
    command.add_value("--shunt-ohm", float, "OHM", "resistance of the shunt resistor, up to 10")
    command.add_value("--voltage-ratio", float, "X", "volts at the coil per volt at the input", 1.0)
    command.add_value("--moving-mass-kg", float, "KG", "moving mass, if it was weighed; gives Bl")
    command.add_value("--output-channel", int, "N", "output channel to play on, from 1", 1)
    command.add_value("--level", float, "L", "part of full scale, up to 0.25; default: 0.05")
    command.add_switch("--loud", "allow a --level up to 1")
    command.add_value("--rig", str, "NAME|FILE", "known values of the rig", "paper")
    command.add_switch("--seat", "simulated rig: mount it in a seat")
    command.add_value(
        "--share", float, "S", "simulated rig: part of Xmax, up to 0.15; default: 0.05"
    )
    command.add_value("--low-hz", float, "HZ", "lowest frequency", 15.0)
    command.add_value("--high-hz", float, "HZ", "highest frequency", 400.0)
    command.add_value("--seconds", duration, "S", "duration of each sweep", 5.0)
    command.add_value("--out", Path, "FILE", "rig file to write")
    command.add_json()


@_command("install the effect as a plugin of other audio software", "install --device NODE")
def _plugin(command: Parser) -> None:
    from audioflinger_hook.config.profiles import LIVE_DEFAULT, PROFILES

    does = "path: print its path; install: install it for this user; remove: remove it"
    verbs = ("path", "install", "remove")
    command.add_argument("does", choices=verbs, metavar="|".join(verbs), help=does)
    names = f"profile of the PipeWire chain: {', '.join(PROFILES)}"
    command.add_value("--profile", str, "NAME", names, LIVE_DEFAULT).choices = tuple(PROFILES)
    command.add_value(
        "--device", str, "NODE", "also write a PipeWire chain that plays to this sink"
    )
    command.add_value("--rate", int, "HZ", "also write settings for this sample rate")


@_command("start the daemon at every login", "--device usb:152a:8750")
def _install_service(command: Parser) -> None:
    command.add_value("--device", str, "DEVICE", f"{SEE_DEVICES}; default: the config's")
    command.add_value("--tap", str, "TAP", "where the sound comes from; default: the config's")
    command.add_switch("--remove", "remove the unit")
    rule = "print a udev rule for USB devices; without a device, install nothing"
    command.add_switch("--udev", rule)


@_command("find the faults of this set-up, with advice", "--report report.txt")
def _doctor(command: Parser) -> None:
    fixes = "repair what needs no root: a stale lock, the plugin's copy, a folder, a muted device"
    command.add_switch("--fix", fixes)
    text = "also write everything to a text file, without names of files, windows or streams"
    command.add_value("--report", Path, "FILE", text)
    command.add_switch("--measure", "play bursts of sound for 3 s, and measure their delay")
    command.add_json()


@_command("report every mistake of a config file", "--config config.toml")
def _check(command: Parser) -> None:
    command.add_value("--config", Path, "FILE", "default: ~/.config/cushion/config.toml")
    command.add_switch("--schema", "print the JSON Schema of the config, for editors")
    command.add_json()
