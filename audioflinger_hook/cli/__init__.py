"""The `cushion` command: one module a subcommand."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from collections.abc import Sequence
from types import FrameType

from audioflinger_hook.cli.parser import build_parser
from device.errors import CushionError, InternalError

EXIT_INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 2 to 5, or 130 when interrupted.

    Whatever goes wrong is one line on stderr; `--debug` adds the traceback.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    debug = "--debug" in arguments
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        options = build_parser().parse_args(arguments)
        code: int = options.run(options)
        sys.stdout.flush()
        return code
    except CushionError as error:
        return _report(error, error.exit_code, debug)
    except KeyboardInterrupt:
        print("cushion: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # The reader of our output has gone; nothing more can be said to it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        kind = type(error).__name__
        wrapped = InternalError(f"{kind}: {error}; this is a fault of cushion, please report it")
        return _report(wrapped, InternalError.exit_code, debug)


def _report(error: Exception, code: int, debug: bool) -> int:
    if debug:
        traceback.print_exc()
    print(f"cushion: error: {error}", file=sys.stderr)
    return code


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    """Treat a request to end as an interruption, so that nothing is left half-written."""
    raise KeyboardInterrupt
