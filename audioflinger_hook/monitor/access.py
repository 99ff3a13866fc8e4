"""Access control of the page, by key, host and origin.

Web pages of other sites can send requests to this computer. Such requests lack the key or have a
foreign Origin header, and get no data of the daemon. Requests with an unknown Host header, as after
DNS rebinding, are refused.

An address that opens the page ends with a code. The page exchanges the code for the key. Each code
is an empty file in the daemon's folder, named after the code's hash, so other processes can make
codes. Its time of modification is the time at which the code was made.
"""

import hmac
import os
import re
import secrets
import socket
import stat
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from audioflinger_hook.service.runtime_folder import RuntimeFolder
from device.errors import UsageError, WriteError

KEY_NAME = "page.token"
KEY_BYTES = 16
CODE_S = 60.0  # time for which a code is valid
CODE_NAME = "page.code."
CODE_SIGNS, CODE_LENGTH = "23456789abcdefghjkmnpqrstuvwxyz", 12  # 59 bits, easy to type
DEFAULT = "127.0.0.1:8765"
LOOPBACK = ("127.0.0.1", "localhost", "[::1]")


@dataclass(frozen=True)
class Listen:
    """Address of the page's server: a host as in a URL, and a port."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> "Listen":
        """Parse HOST:PORT; port 0 selects a free port. UsageError: the text is not valid."""
        host, colon, port = text.rpartition(":")
        good = re.fullmatch(r"[\w.-]+|\[[0-9A-Fa-f:.]+\]", host) and re.fullmatch(r"\d{1,5}", port)
        if not colon or not good or int(port) > 65_535:
            allowed = "HOST:PORT, such as 127.0.0.1:8765 or [::1]:8765"
            raise UsageError(f"--listen {text[:60]!r} is no address; allowed: {allowed}")
        return cls(host.lower(), int(port))

    @property
    def command(self) -> str:
        """The command that serves this address, or prints an address with a new code."""
        chosen = f"{self.host}:{self.port}"
        return "cushion monitor" + (f" --listen {chosen}" if chosen != DEFAULT else "")

    @property
    def url(self) -> str:
        """The page's URL, without a code."""
        return f"http://{self.shown_host}:{self.port}/"

    @property
    def shown_host(self) -> str:
        """Host in the printed address. For a wildcard host, this is the computer's host name."""
        return socket.gethostname().lower() if self.host in ("0.0.0.0", "[::]") else self.host


def load_key(folder: RuntimeFolder) -> str:
    """Return the page's key, a new one if none is valid. WriteError: no access to its file."""
    path = folder.path / KEY_NAME
    try:
        with suppress(FileNotFoundError):
            fd = os.open(KEY_NAME, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder.fd)
            with os.fdopen(fd, "rb") as file:
                found, known = os.fstat(fd), file.read(100)
            private = found.st_uid == os.geteuid() and stat.S_IMODE(found.st_mode) == 0o600
            form = rb"[0-9a-f]{%d}" % (2 * KEY_BYTES)
            if stat.S_ISREG(found.st_mode) and private and re.fullmatch(form, known):
                return known.decode()
            os.unlink(KEY_NAME, dir_fd=folder.fd)
        key = secrets.token_hex(KEY_BYTES)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
        fd = os.open(KEY_NAME, flags, 0o600, dir_fd=folder.fd)
        with os.fdopen(fd, "w") as file:
            file.write(key)
    except OSError as error:
        raise WriteError(f"cannot keep the key in {path}: {error.strerror}; remove it") from error
    return key


def new_code(folder: RuntimeFolder, now_s: float) -> str:
    """Return a new code, valid once, for CODE_S. now_s: time of day. WriteError: not stored."""
    code = "".join(secrets.choice(CODE_SIGNS) for _ in range(CODE_LENGTH))
    try:
        for known in folder.path.glob(f"{CODE_NAME}*"):
            if not _is_valid(known, now_s):
                known.unlink(missing_ok=True)
        path = _file_of(folder, code)
        path.touch(0o600, exist_ok=False)
        os.utime(path, (now_s, now_s))
    except OSError as error:
        raise WriteError(f"cannot keep a code in {folder.path}: {error.strerror}") from error
    return code


def _file_of(folder: RuntimeFolder, code: str) -> Path:
    return folder.path / (CODE_NAME + sha256(code.lower().encode("utf-8", "replace")).hexdigest())


def _is_valid(path: Path, now_s: float) -> bool:
    """Whether a code is young enough. A second is left for the rounding of file times."""
    with suppress(OSError):
        return -1.0 <= now_s - path.stat().st_mtime <= CODE_S
    return False


class Access:
    """Checks requests to the server at `listen`. key: what a browser gets for a code."""

    def __init__(self, listen: Listen, key: str, folder: RuntimeFolder) -> None:
        self.key, self._folder = key, folder
        opens = " --open" if listen.host in LOOPBACK else ""  # a phone's tab opens by its address
        self.advice = f"this tab has no key; run `{listen.command}{opens}`"[:123]
        names = {*LOOPBACK, listen.host, listen.shown_host}
        self._hosts = {f"{name}:{listen.port}" for name in names}
        self._port = listen.port

    def refuse_host(self, hosts: list[str], own_address: str) -> str:
        """Return why the Host headers are refused, or "". own_address: the server's IP address."""
        own_address = own_address.removeprefix("::ffff:")  # prefix of IPv4-mapped addresses
        own = f"[{own_address}]" if ":" in own_address else own_address
        if len(hosts) == 1 and hosts[0].lower() in self._hosts | {f"{own}:{self._port}"}:
            return ""
        return "the host is not this server; open the address that `cushion monitor` prints"

    def refuse_origin(self, origins: list[str], host: str, *, needed: bool) -> str:
        """Return why the Origin headers are refused, or "". needed: whether one is required."""
        if not origins and not needed:
            return ""
        if len(origins) == 1 and origins[0].lower() == f"http://{host.lower()}":
            return ""
        return "the request comes from another page; only this server's own page may connect"

    def is_key(self, given: object) -> bool:
        """Whether `given` is the key, compared in constant time."""
        return hmac.compare_digest(str(given).encode("utf-8", "replace"), self.key.encode())

    def admits(self, key: object, code: object, now_s: float) -> bool:
        """Whether the key is right, or the code is valid, which ends that. now_s: time of day."""
        is_admitted, path = self.is_key(key), _file_of(self._folder, str(code))
        with suppress(OSError):
            is_valid = _is_valid(path, now_s)
            path.unlink()  # of two that use the code at once, only one succeeds
            is_admitted |= is_valid
        return is_admitted

    def has_bearer(self, headers: list[str]) -> bool:
        """Whether there is exactly one Authorization header, and this header has the key."""
        scheme, _, given = headers[0].partition(" ") if len(headers) == 1 else ("", "", "")
        return scheme.lower() == "bearer" and self.is_key(given.strip())
