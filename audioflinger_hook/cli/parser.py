"""The command line's grammar."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from audioflinger_hook import __version__
from device.errors import UsageError

DESCRIPTION = "Feel what a computer plays: sound in, vibration of 20-220 Hz out."
EXIT_CODES = (
    "exit codes: 0 done; 2 wrong usage, config or input; 3 no such tap or device; 4 the sound "
    "server or device was lost; 5 internal error or write failure; 130 interrupted"
)


PROFILE_HELP = "paper, cinema, game or music; default: paper"


class Parser(argparse.ArgumentParser):
    """A parser that reports wrong usage as every other error is reported, and guesses nothing.

    any_order: whether options may stand between the names of files, however many these are.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**{**options, "allow_abbrev": False})
        self.any_order = False

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Return what was found, and what nobody knows."""
        if not self.any_order:
            return super().parse_known_args(args, namespace)
        given = list(sys.argv[1:] if args is None else args)
        if "--" in given:
            # What is left comes here again without the mark: no name may look like an option then.
            place = given.index("--")
            names = (f"./{name}" if name.startswith("-") else name for name in given[place + 1 :])
            given = [*given[:place], *names]
        self.any_order = False  # the options first, then what is left: both come here again
        try:
            return self.parse_known_intermixed_args(given, namespace)
        finally:
            self.any_order = True

    def error(self, message: str) -> NoReturn:
        """Raise UsageError."""
        raise UsageError(f"{message}; see `{self.prog} --help`")


def build_parser() -> Parser:
    """Return the parser; `run` of what it parses is the function that does the command."""
    parser = Parser(prog="cushion", description=DESCRIPTION, epilog=EXIT_CODES)
    _add_debug(parser)
    parser.add_argument("--version", action="version", version=f"cushion {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)

    demo = _add(commands, "demo", "play the bundled scene through the whole chain")
    demo.add_argument("--out", type=Path, default=Path("out"), metavar="DIR")
    demo.add_argument("--profile", metavar="NAME", help=PROFILE_HELP)
    demo.add_argument("--fast", action="store_true", help="as fast as it can, not in real time")

    render = _add(commands, "render", "write the vibration of sound files")
    render.usage = "%(prog)s [options] IN OUT\n       %(prog)s [options] --out-dir DIR IN..."
    # Both are one list here: what is missing or too much `cli.render` says.
    render.any_order = True
    render.add_argument(
        "files",
        nargs="*",
        type=Path,
        metavar="IN OUT",
        help="any sound file, and the float32 WAV to be written",
    )
    render.add_argument(
        "--out-dir", type=Path, metavar="DIR", help="write DIR/IN.wav for every IN, several at once"
    )
    render.add_argument(
        "--workers", type=_count, metavar="N", help="processes at once; default: the usable cores"
    )
    _add_rendering(render)

    inspect = _add(commands, "inspect", "list the principal frequencies of a sound file")
    inspect.add_argument("input", type=Path, metavar="IN")
    inspect.add_argument("--at", type=_seconds, metavar="SECONDS", help="only the unit there")
    _add_json(inspect)

    capture = _add(commands, "capture", "record buffers of sound as they are delivered")
    capture.add_argument("folder", type=Path, metavar="OUTDIR", help="a new or empty folder")
    _add_tap(capture)
    capture.add_argument(
        "--seconds", type=_duration, default=math.inf, metavar="S", help="default: to its end"
    )

    replay = _add(commands, "replay", "write the vibration of a capture")
    replay.add_argument("folder", type=Path, metavar="DIR", help="a capture")
    replay.add_argument("output", type=Path, metavar="OUT", help="float32 WAV")
    replay.add_argument("--speed", default="max", metavar="1|max", help="default: max")
    _add_rendering(replay)

    dump = _add(commands, "dump", "show threads, tracks, effects and counters")
    _add_tap(dump)
    dump.add_argument(
        "--at", type=_seconds, default=1.0, metavar="SECONDS", help="of sound; default: 1"
    )
    dump.add_argument("--config", type=Path, metavar="FILE", help="take the settings from it")

    run = _add(commands, "run", "feel everything this computer plays")
    run.add_argument(
        "--tap",
        action="append",
        metavar="TAP",
        help="default, sink:NAME, app:NAME (again for more), file:PATH, capture:DIR or scene:demo; "
        "default: default",
    )
    run.add_argument(
        "--device",
        metavar="DEVICE",
        help="sink:NAME, usb:VID:PID[:SERIAL][@PORT], hw:CARD, wav:FILE or twin",
    )
    run.add_argument("--record", type=Path, metavar="DIR", help="keep it all in a new folder")
    run.add_argument(
        "--drop-in",
        action="store_true",
        default=None,
        help="stand between applications and their sink, which can delay the sound",
    )
    run.add_argument("--config", type=Path, metavar="FILE", help="default: the user's own")
    run.add_argument(
        "--seconds", type=_duration, default=math.inf, metavar="S", help="of sound; default: ever"
    )
    run.add_argument("--offset-ms", type=float, metavar="MS", help="delay it more; default: 0")
    run.add_argument(
        "--device-volume-db",
        type=float,
        metavar="DB",
        help="set the device's own volume, 0 at most; default: leave it",
    )
    run.add_argument("--profile", metavar="NAME", help=PROFILE_HELP)
    run.add_argument("--rig", metavar="NAME|FILE", help="what is driven; default: paper")
    run.add_argument("--damping", metavar="off|auto", help="of the rig; default: off")
    run.add_argument("--protection", metavar="off|on", help="of the rig; default: off")
    run.add_argument(
        "--wait", action="store_true", help="for a server, device or tap that is not there yet"
    )

    status = _add(commands, "status", "ask a running daemon")
    status.add_argument("--watch", action="store_true", help="again and again")
    _add_json(status)

    devices = _add(commands, "devices", "list outputs, and who plays")
    _add_json(devices)

    usb = _add(commands, "usb", "decode a USB audio device, or a dump of one")
    usb.add_argument("does", choices=("describe",), metavar="describe", help="what it says it is")
    usb.add_argument(
        "device", nargs="?", metavar="DEVICE", help="usb:VID:PID[:SERIAL][@PORT]; default: all"
    )
    usb.add_argument("--hex", type=Path, metavar="FILE", help="decode a dump; - is standard input")
    usb.add_argument(
        "--take-over",
        action="store_true",
        help="ask volumes and rates, too: its sound card is gone meanwhile",
    )
    _add_json(usb)

    tone = _add(commands, "test-tone", "vibrate one output, to find the right one")
    tone.add_argument("--device", required=True, metavar="DEVICE", help="see `cushion devices`")
    tone.add_argument("--hz", type=float, default=60.0, metavar="HZ", help="default: 60")
    tone.add_argument("--level", type=float, default=0.2, metavar="L", help="default: 0.2 of 1")
    tone.add_argument("--seconds", type=float, default=2.0, metavar="S", help="default: 2")

    calibrate = _add(commands, "calibrate", "measure a rig by sweeps, from low on")
    calibrate.add_argument(
        "--device",
        required=True,
        metavar="DEVICE",
        help="see `cushion devices`, or twin",
    )
    calibrate.add_argument(
        "--input", metavar="INPUT", help="what hears it: source:NAME or hw:CARD[,DEVICE]"
    )
    calibrate.add_argument(
        "--channels",
        metavar="A,B,...",
        help="what each input channel is: acceleration, current, voltage, loopback, or -",
    )
    calibrate.add_argument(
        "--input-full-scale-v", type=float, metavar="V", help="peak volts at the input's full scale"
    )
    calibrate.add_argument(
        "--acceleration-mv-per-m-s2", type=float, metavar="MV", help="of the accelerometer"
    )
    calibrate.add_argument(
        "--shunt-ohm", type=float, metavar="OHM", help="what the current's channel is across"
    )
    calibrate.add_argument(
        "--voltage-ratio",
        type=float,
        default=1.0,
        metavar="X",
        help="volts at the coil per volt at the input; default: 1",
    )
    calibrate.add_argument(
        "--moving-mass-kg", type=float, metavar="KG", help="what moves, if it was weighed: gives Bl"
    )
    calibrate.add_argument(
        "--output-channel", type=int, default=1, metavar="N", help="that plays, from 1; default: 1"
    )
    calibrate.add_argument(
        "--level", type=float, metavar="L", help="of full scale, up to 0.25; default: 0.05"
    )
    calibrate.add_argument("--loud", action="store_true", help="allow a --level up to 1")
    calibrate.add_argument(
        "--rig", default="paper", metavar="NAME|FILE", help="what is known of it; default: paper"
    )
    calibrate.add_argument("--seat", action="store_true", help="the twin stands on its seat")
    calibrate.add_argument(
        "--share", type=float, metavar="S", help="the twin: of Xmax, up to 0.15; default: 0.05"
    )
    calibrate.add_argument("--low-hz", type=float, default=15.0, metavar="HZ", help="default: 15")
    calibrate.add_argument(
        "--high-hz", type=float, default=400.0, metavar="HZ", help="default: 400"
    )
    calibrate.add_argument(
        "--seconds", type=_duration, default=5.0, metavar="S", help="of each sweep; default: 5"
    )
    calibrate.add_argument("--out", type=Path, metavar="FILE", help="the rig's file, to be written")
    _add_json(calibrate)

    service = _add(commands, "install-service", "run from every login on")
    service.add_argument(
        "--device", metavar="DEVICE", help="see `cushion devices`; default: the config's"
    )
    service.add_argument("--tap", metavar="TAP", help="default: the config's")
    service.add_argument("--remove", action="store_true", help="take it away again")
    service.add_argument("--udev", action="store_true", help="print a rule for USB devices, too")

    check = _add(commands, "check", "report every mistake of a config file")
    check.add_argument("--config", type=Path, metavar="FILE", help="default: the user's own")
    _add_json(check)
    return parser


def _add(
    commands: argparse._SubParsersAction[Parser],
    name: str,
    does: str,
) -> Parser:
    """Add a command, which is the `run` of the module of its name."""
    command = commands.add_parser(name, help=does, description=does, epilog=EXIT_CODES)
    _add_debug(command)

    def run(options: argparse.Namespace) -> int:
        # Imported when it runs: what it needs may take a second to load.
        module = import_module(f"audioflinger_hook.cli.{name.replace('-', '_')}")
        code: int = module.run(options)
        return code

    command.set_defaults(run=run)
    return command


def _add_rendering(command: Parser) -> None:
    """Add what `render` and `replay` share."""
    command.add_argument("--transform", dest="form", metavar="reference|live", help="default: live")
    command.add_argument("--channels", metavar="mono|each", help="default: mono")
    command.add_argument("--profile", metavar="NAME", help=PROFILE_HELP)
    command.add_argument("--rig", metavar="NAME|FILE", help="what is driven; default: paper")
    command.add_argument("--damping", metavar="off|auto", help="of the rig; default: off")
    command.add_argument("--protection", metavar="off|on", help="of the rig; default: off")
    command.add_argument("--acceleration", type=Path, metavar="FILE", help="what the rig would do")
    command.add_argument("--config", type=Path, metavar="FILE", help="take the settings from it")
    _add_json(command)


def _add_tap(command: Parser) -> None:
    command.add_argument(
        "--tap",
        default="default",
        metavar="TAP",
        help="default, sink:NAME, app:NAME, file:PATH, capture:DIR or scene:demo",
    )


def _add_debug(parser: Parser) -> None:
    parser.add_argument("--debug", action="store_true", help="show tracebacks")


def _add_json(command: Parser) -> None:
    command.add_argument("--json", action="store_true", help="one JSON document on stdout")


def _count(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time in seconds from 0")
    return value


def _duration(text: str) -> float:
    value = _seconds(text)
    if not value:
        raise argparse.ArgumentTypeError(f"{text!r} is no time to listen; allowed: above 0 seconds")
    return value
