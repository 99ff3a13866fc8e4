"""The `cushion` command: one module per subcommand."""

from __future__ import annotations

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
from device.errors import CushionError, InternalError, WriteError

EXIT_INTERRUPTED = 130

STDOUT_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Errors of printing; the program's own files report these errors themselves."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 2 to 5, or 130 when interrupted.

    An error is one line on stderr; `--debug` adds the traceback.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    debug = "--debug" in arguments
    _end_softly()
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
        except OSError:  # the terminal was closed
            _discard(sys.stdout)
            _discard(sys.stderr)
        # Where an `exec` in a module's import was interrupted, `python -m` would kill itself by the
        # signal at its end; another one makes it forget that.
        exec("")
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader of our output is gone
        _discard(sys.stdout)
        return 0
    except Exception as error:
        if isinstance(error, OSError) and error.errno in STDOUT_ERRORS and not error.filename:
            _discard(sys.stdout)
            full = f"cannot write to standard output ({error.strerror})"
            return _report(WriteError(full), debug)
        fault = f"{type(error).__name__}: {error}; this is a fault of cushion, please report it"
        return _report(InternalError(fault), debug)


def _run(arguments: Sequence[str]) -> int:
    parser = build_parser()
    try:
        options = parser.parse_args(arguments)
    except SystemExit as done:  # raised by the parser for --help and --version
        return int(done.code or 0)
    if options.command is None:
        parser.print_help()
        print(f"\n{NEXT}")
        return 0
    # Imported only now: some imports take a second.
    module = import_module(f"audioflinger_hook.cli.{options.command.replace('-', '_')}")
    return int(module.run(options))


def _prepare_streams() -> None:
    """Let print work with any file name, and if the caller has closed stdout or stderr."""
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:  # else the next opened file would get this descriptor
            os.open(os.devnull, os.O_RDWR)
    sys.stdout = sys.stdout or io.StringIO()
    sys.stderr = sys.stderr or io.StringIO()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a file's name may be no valid text
            stream.reconfigure(errors="backslashreplace")


def _discard(stream: TextIO) -> None:
    """Drop buffered output, so that the interpreter does not try to write it at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _report(error: CushionError, debug: bool) -> int:
    if debug:
        traceback.print_exc()
    with contextlib.suppress(OSError):  # stderr may have no reader
        print(f"cushion: error: {error}", file=sys.stderr, flush=True)
    return error.exit_code


def _end_softly() -> None:
    """End by KeyboardInterrupt after SIGTERM, and if the terminal was closed.

    So no file is left half-written, and no stream or module stays on the sound server.
    """
    signal.signal(signal.SIGTERM, _interrupt)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as `nohup` sets it
        signal.signal(signal.SIGHUP, _interrupt)


def _interrupt(number: int, _frame: FrameType | None) -> None:
    if number == signal.SIGHUP:  # the shell sends another one
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    raise KeyboardInterrupt
