"""Access control of the page, by token, host and origin.

Web pages of other sites can send requests to this computer. Such requests lack the token or have a
foreign Origin header, and get no data of the daemon. Requests with an unknown Host header, as after
DNS rebinding, are refused.
"""

import hmac
import os
import re
import secrets
import socket
import stat
from dataclasses import dataclass

from audioflinger_hook.service.runtime_folder import RuntimeFolder
from device.errors import UsageError, WriteError

TOKEN_NAME = "page.token"
TOKEN_BYTES = 16
LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
WILDCARDS = ("0.0.0.0", "[::]")

_TOKEN = re.compile(rb"[0-9a-f]{%d}" % (2 * TOKEN_BYTES))


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
    def shown_host(self) -> str:
        """Host in the printed address. For a wildcard host, this is the computer's host name."""
        return socket.gethostname().lower() if self.host in WILDCARDS else self.host


def load_token(folder: RuntimeFolder) -> str:
    """Return the page's token. If the daemon's folder has no valid token, store a new one there.

    WriteError: the token cannot be read or stored.
    """
    path = folder.path / TOKEN_NAME
    try:
        try:
            fd = os.open(TOKEN_NAME, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder.fd)
            with os.fdopen(fd, "rb") as file:
                found, known = os.fstat(fd), file.read(100)
            private = found.st_uid == os.geteuid() and stat.S_IMODE(found.st_mode) == 0o600
            if stat.S_ISREG(found.st_mode) and private and _TOKEN.fullmatch(known):
                return known.decode()
            os.unlink(TOKEN_NAME, dir_fd=folder.fd)
        except FileNotFoundError:
            pass
        token = secrets.token_hex(TOKEN_BYTES)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
        fd = os.open(TOKEN_NAME, flags, 0o600, dir_fd=folder.fd)
        with os.fdopen(fd, "w") as file:
            file.write(token)
    except OSError as error:
        raise WriteError(f"cannot keep the token in {path}: {error.strerror}; remove it") from error
    return token


class Access:
    """Checks requests. Any thread may use it. cookie: value of the header Set-Cookie."""

    def __init__(self, listen: Listen, token: str) -> None:
        self._token = token.encode()
        self.cookie_name = f"cushion_{listen.port}"
        self.cookie = f"{self.cookie_name}={token}; Path=/; HttpOnly; SameSite=Strict"
        names = {*LOOPBACK, listen.host, listen.shown_host}
        self._hosts = {f"{name}:{listen.port}" for name in names}
        self._port = listen.port

    def refuse_host(self, hosts: list[str], own_address: str) -> str:
        """Return why the Host headers are refused, or "". own_address: the server's IP address."""
        own_address = own_address.removeprefix("::ffff:")  # prefix of IPv4-mapped addresses
        own = f"[{own_address}]" if ":" in own_address else own_address
        known = self._hosts | {f"{own}:{self._port}"}
        if len(hosts) == 1 and hosts[0].lower() in known:
            return ""
        return "the host is not this server; open the address that `cushion monitor` prints"

    def refuse_origin(self, origins: list[str], host: str, *, needed: bool) -> str:
        """Return why the Origin headers are refused, or "". needed: whether one is required."""
        if not origins and not needed:
            return ""
        if len(origins) == 1 and origins[0].lower() == f"http://{host.lower()}":
            return ""
        return "the request comes from another page; only this server's own page may connect"

    def is_token(self, given: str) -> bool:
        """Whether `given` is the token, compared in constant time."""
        return hmac.compare_digest(given.encode("utf-8", "replace"), self._token)

    def has_cookie(self, header: str) -> bool:
        """Whether a Cookie header contains the token."""
        pairs = [part.strip().partition("=") for part in header[:4096].split(";")]
        given = [value for name, _, value in pairs if name == self.cookie_name]
        return len(given) == 1 and self.is_token(given[0])

    def has_bearer(self, headers: list[str]) -> bool:
        """Whether there is exactly one Authorization header, and this header has the token."""
        scheme, _, given = headers[0].partition(" ") if len(headers) == 1 else ("", "", "")
        return scheme.lower() == "bearer" and self.is_token(given.strip())
