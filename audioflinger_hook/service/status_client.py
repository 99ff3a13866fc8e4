"""Client of a running daemon: requests its status, and controls it."""

import json
import os
import socket
import struct
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from audioflinger_hook.service.json_codec import from_json
from audioflinger_hook.service.one_line import one_line
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.status import Status
from audioflinger_hook.service.status_server import ASK_STATUS, NAME, PROTOCOL, peer_uid
from device.errors import CushionError, InternalError, NotFoundError, UsageError

ANSWER_BYTES_MAX = 1 << 20
NO_DAEMON = "no daemon is running; start one with `cushion run`"


def ask_status(
    timeout_s: float, clock: Callable[[], float], environ: Mapping[str, str] = os.environ
) -> Status:
    """Return the status of this user's daemon; wait up to `timeout_s`.

    clock: returns seconds. NotFoundError: no daemon is running. UsageError: $XDG_RUNTIME_DIR is not
    usable, or the folder or socket belongs to another user. InternalError: the daemon does not
    answer in time, or the client does not understand the answer.
    """
    line = _answer(ASK_STATUS, timeout_s, clock, environ)
    try:
        return from_json(Status, line)
    except CushionError as error:
        reason = _error_in(line) or f"its answer is not understood ({error})"
        missing = f"the daemon does not report its status: {reason}"
        raise InternalError(f"{missing}; restart it with this version") from error


def ask_control(request: Mapping[str, Any], timeout_s: float, clock: Callable[[], float]) -> Any:
    """Let this user's daemon carry out a request of the form that `daemon/live_control.py` lists.

    Return its answer, a dict. UsageError: it refuses. Other errors, arguments: see `ask_status`.
    """
    asked = {**request, "ask": "control", "protocol": PROTOCOL}
    line = _answer(asked, timeout_s, clock, os.environ)
    if refused := _error_in(line):
        raise UsageError(f"the daemon refuses the request: {refused}")
    try:
        return {**json.loads(line)}
    except (ValueError, TypeError, RecursionError) as error:  # TypeError: it is no object
        raise InternalError("the daemon's answer is not understood; restart it") from error


def _answer(
    request: Mapping[str, Any],
    timeout_s: float,
    clock: Callable[[], float],
    environ: Mapping[str, str],
) -> bytes:
    end_s = clock() + timeout_s
    try:
        with (
            RuntimeFolder(environ, create=False) as folder,
            socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client,
        ):
            # Use a blocking socket with timeouts of the operating system. A non-blocking `connect`
            # would fail if the queue of the listening socket is full.
            _set_timeout(client, socket.SO_SNDTIMEO, end_s - clock())
            client.connect(folder.address(NAME))
            owner = peer_uid(client)
            if owner != os.geteuid():
                raise UsageError(f"the daemon at {folder.path / NAME} runs as user {owner}")
            client.sendall(json.dumps(request).encode() + b"\n")
            answer = bytearray()
            while not answer.endswith(b"\n"):
                _set_timeout(client, socket.SO_RCVTIMEO, end_s - clock())
                received = client.recv(65_536)
                answer += received
                if not received or len(answer) > ANSWER_BYTES_MAX:
                    raise InternalError("the daemon's answer is cut off or too long; try again")
            return bytes(answer)
    except (TimeoutError, BlockingIOError) as error:
        late = f"the daemon has not answered within {timeout_s:g} s; try again, or restart it"
        raise InternalError(late) from error
    except (NotFoundError, FileNotFoundError, ConnectionRefusedError) as error:
        raise NotFoundError(NO_DAEMON) from error
    except PermissionError as error:
        refused = f"no permission to connect to {folder.path / NAME}"
        raise UsageError(f"{refused}; run as the daemon's user") from error
    except OSError as error:
        raise InternalError(f"the daemon does not answer: {error.strerror}; try again") from error


def _set_timeout(client: socket.socket, option: int, left_s: float) -> None:
    if left_s <= 0.0:
        raise TimeoutError
    microseconds = max(1, int(1e6 * left_s))  # 0 would disable the timeout
    value = struct.pack("@ll", *divmod(microseconds, 1_000_000))
    client.setsockopt(socket.SOL_SOCKET, option, value)


def _error_in(line: bytes) -> str:
    """Return the text of a line `{"error": ...}`, or "" for other lines."""
    with suppress(ValueError, RecursionError):
        match json.loads(line):
            case {"error": str(error)}:
                return one_line(error)
    return ""
