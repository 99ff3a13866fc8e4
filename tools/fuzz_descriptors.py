"""Looks for bytes that the descriptor parser cannot stand: tools/fuzz_descriptors.py [FOLDER] ...

Atheris changes the descriptors of the tests' devices, guided by which lines of the parser they
reach, until something goes wrong or it is stopped. What it found worth keeping is in FOLDER
(out/fuzz_descriptors by default), inputs that failed are written beside it as crash-*. Everything
else on the command line goes to libFuzzer: -runs=100000, -max_total_time=600, -help=1.
"""

from __future__ import annotations

import importlib
import sys
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from device.usb.descriptors import (
    Configuration,
    DescriptorError,
    describe,
    parse_configuration,
    parse_device,
    parse_whole,
    playback_formats,
)
from device.usb.descriptors.reading import BYTES_MAX
from device.usb.descriptors.standard import CONFIGURATION, CONFIGURATION_BYTES

ROOT = Path(__file__).resolve().parents[1]
BYTES_USUAL_MAX = 2_048
MISSING = (
    "fuzz_descriptors: error: atheris is not installed; `pip install atheris` "
    "(it needs clang where it has no wheel)"
)


def exercise(raw: bytes) -> bool:
    """Do with bytes all that can be done with them; whether they are a configuration.

    Raises
    ------
    AssertionError
        Strict and forgiving reading differ in more than they should, or a byte got lost.
    Exception
        Anything but a DescriptorError that reading may raise.
    """
    with suppress(DescriptorError):
        parse_device(raw)
    configuration, said = read(raw, strict=False)
    strict, strictly_said = read(raw, strict=True)
    if configuration is None:
        begins = len(raw) > 1 and CONFIGURATION_BYTES <= raw[0] <= len(raw)
        assert not (begins and raw[1] == CONFIGURATION), said
        assert strictly_said == said
        return False
    assert configuration.raw() == raw[:BYTES_MAX]
    if configuration.problems:
        assert strictly_said == str(configuration.problems[0])
    else:
        assert strict == configuration
    playback_formats(configuration)
    describe(None, configuration)
    whole = parse_whole(raw)
    assert len(raw) > BYTES_MAX or whole.raw() == raw
    whole.active(None)
    return True


def read(raw: bytes, strict: bool) -> tuple[Configuration | None, str]:
    """The configuration, or None and what the error says."""
    try:
        return parse_configuration(raw, strict=strict), ""
    except DescriptorError as error:
        return None, str(error)


def main() -> int:
    """Fuzz until stopped; 2 where that cannot be done."""
    try:
        atheris = importlib.import_module("atheris")
    except ImportError:
        print(MISSING, file=sys.stderr)
        return 2
    shapes = importlib.import_module("tests.support.usb_shapes").SHAPES
    options = [argument for argument in sys.argv[1:] if argument.startswith("-")]
    folders = [argument for argument in sys.argv[1:] if not argument.startswith("-")]
    folder = Path(folders[0]) if folders else ROOT / "out" / "fuzz_descriptors"
    folder.mkdir(parents=True, exist_ok=True)
    for name, raw in shapes.items():
        (folder / name).write_bytes(raw)
    if not any(option.startswith("-max_len=") for option in options):
        options.append(f"-max_len={BYTES_USUAL_MAX}")
    options.append(f"-artifact_prefix={folder.parent}/")
    atheris.instrument_all()
    atheris.Setup([sys.argv[0], *options, str(folder)], exercise_quietly)
    atheris.Fuzz()
    return 0


def exercise_quietly(raw: bytes) -> None:
    """`exercise` as libFuzzer calls it: it takes no answer."""
    exercise(raw)


if __name__ == "__main__":
    sys.exit(main())
