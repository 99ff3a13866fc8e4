"""The `cushion` command: one module for each subcommand."""

import contextlib
import errno
import io
import os
import signal
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module
from types import FrameType
from typing import TextIO

from audioflinger_hook.cli.parser import NEXT, build_parser
from device.errors import CushionError, WriteError, unexpected
from device.whole_process import NUMPY_MB, repeat_lost_interruptions, respect_memory_limit

EXIT_INTERRUPTED = 130
LIGHT = ("check", "status")  # commands that multiply no matrices

STDOUT_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)  # `errno` of a failed `print`


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0, 2 to 5, or 130. Errors are printed on stderr."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    debug = "--debug" in arguments
    # SIGTERM, and SIGHUP unless `nohup` ignores it, close all files, as Ctrl+C does.
    signal.signal(signal.SIGTERM, _interrupt)
    repeat_lost_interruptions()
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, _interrupt)
    _prepare_streams()
    try:
        code = _run(arguments)
        sys.stdout.flush()
        return code
    except CushionError as error:
        return _report(error, debug)
    except KeyboardInterrupt:
        try:
            print("cushion: interrupted", file=sys.stderr)
            sys.stdout.flush()
        except OSError:  # the terminal is closed
            _discard(sys.stdout)
            _discard(sys.stderr)
        # If a signal interrupts `exec` during an import, `python -m` later kills itself with this
        # signal. A further `exec` clears the interpreter's record of the interruption.
        exec("")
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader of stdout has closed the pipe
        _discard(sys.stdout)
        return 0
    except Exception as error:
        if isinstance(error, OSError) and error.errno in STDOUT_ERRORS and not error.filename:
            _discard(sys.stdout)
            return _report(WriteError(f"cannot write to standard output ({error.strerror})"), debug)
        return _report(unexpected(error), debug)


def _run(arguments: Sequence[str]) -> int:
    if not {"-h", "--help", "--version"} & set(arguments):
        respect_memory_limit(NUMPY_MB)
    parser = build_parser()
    try:
        options = parser.parse_args(arguments)
    except SystemExit as done:  # `argparse` exits after --help and --version
        return int(done.code or 0)
    if options.command is None:
        parser.print_help()
        print(f"\n{NEXT}")
        return 0
    if options.command not in LIGHT:
        respect_memory_limit()
    # Import only the module of this command, because some imports are slow.
    module = import_module(f"audioflinger_hook.cli.{options.command.replace('-', '_')}")
    return int(module.run(options))


def _prepare_streams() -> None:
    """Make `print` work with any file name, and with a closed stdout or stderr."""
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:  # otherwise the next opened file would get this descriptor
            os.open(os.devnull, os.O_RDWR)
    sys.stdout = sys.stdout or io.StringIO()
    sys.stderr = sys.stderr or io.StringIO()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a file name may be invalid text
            stream.reconfigure(errors="backslashreplace")


def _discard(stream: TextIO) -> None:
    """Drop the stream's buffered output, which the interpreter would otherwise write at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _report(error: CushionError, debug: bool) -> int:
    if debug:
        traceback.print_exc()
    with contextlib.suppress(OSError):  # stderr may be closed
        print(f"cushion: error: {error}", file=sys.stderr, flush=True)
    return error.exit_code


def _interrupt(number: int, _frame: FrameType | None) -> None:
    if number == signal.SIGHUP:  # ignore a second SIGHUP, which a shell may send
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    raise KeyboardInterrupt
