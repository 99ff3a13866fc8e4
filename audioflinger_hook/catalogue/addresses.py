"""Paths and URLs of sounds and results, and the removal of credentials from messages."""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from audioflinger_hook.catalogue.timing import StorageError
from device.errors import CushionError, UsageError

EXTRA = "URLs need fsspec; pip install 'haptic-cushion[remote]', for s3:// 'haptic-cushion[s3]'"
REMOVED = "[removed]"
NO_CREDENTIALS = (
    "holds credentials; allowed: a URL without password, query and fragment; give credentials to "
    "the storage library by its own settings"
)

_SCHEME = re.compile(r"^[A-Za-z][A-Za-z0-9+.-]*://")
_USERINFO = re.compile(r"(?<=://)[^/\s@]*@|[\w.+-]+:[^\s/@'\"]+@")
_QUERY = re.compile(r"(://[^\s?#'\"]*)[?#][^\s'\"]*")
_SECRET_NAME = re.compile(r"KEY|SECRET|TOKEN|PASSW|CREDENTIAL|SIGNATURE|SAS", re.IGNORECASE)
_SECRET_PAIR = re.compile(
    r"(?i)\b(sig|\w*(?:key|secret|token|passw|credential|signature|authorization|cookie)\w*)"
    r"(\\?[\"']?\s*[=:]\s*)"
    # The value is a word or a quoted text. Its quotes may be escaped. "bearer" or another
    # scheme may precede the word.
    r"(?:\\?\"[^\"]*\"|\\?'[^']*'|(?:(?:bearer|basic|digest|token)\s+)?[^\s,;&]+)"
)
_KEY_ID = re.compile(r"\b(?:AKIA|ASIA)[A-Z0-9]{8,}\b")
_SHORTEST_SECRET = 6


def is_url(address: str) -> bool:
    """Return whether an address is a URL, not a path."""
    return "://" in address and bool(_SCHEME.match(address))


def credentials_in(url: str) -> bool:
    """Return whether a URL contains a password, query or fragment, or cannot be parsed."""
    if not is_url(url):
        return False
    try:
        parts = urlsplit(url)
        return parts.password is not None or bool(parts.query or parts.fragment or "?" in url)
    except ValueError:
        return True


def scrubbed(text: str) -> str:
    """Return a text without possible credentials; whitespace becomes single spaces.

    User names, passwords, queries and fragments of URLs are removed. Values whose name suggests a
    secret, such as "token", and values of environment variables with such names are removed too.
    """
    text = " ".join(text.split())
    for name, value in os.environ.items():
        if len(value) >= _SHORTEST_SECRET and _SECRET_NAME.search(name):
            is_path = os.sep in value and Path(value).exists()  # secrets, too, may hold slashes
            text = text if is_path else text.replace(value, REMOVED)
    text = _USERINFO.sub(f"{REMOVED}@", text)
    text = _QUERY.sub(rf"\1?{REMOVED}", text)
    text = _SECRET_PAIR.sub(rf"\1\2{REMOVED}", text)
    return _KEY_ID.sub(REMOVED, text)


def parse_address(text: str, what: str) -> str:
    """Return a URL or an absolute path. UsageError: the text is empty or contains credentials."""
    if not text or "\0" in text:
        raise UsageError(f"{what} = {text!r} is not a path or URL; name one")
    if credentials_in(text):
        raise UsageError(f"{what} = {scrubbed(text)} {NO_CREDENTIALS}")
    text = text.removeprefix("file://")
    return text.rstrip("/") if is_url(text) else os.path.normpath(Path(text).absolute())


def filesystem_of(url: str) -> tuple[Any, str]:
    """Return a URL's fsspec filesystem and path. UsageError: the URL cannot be used."""
    fsspec = _fsspec(url)
    try:
        filesystem, path = fsspec.core.url_to_fs(url, use_listings_cache=False)
    except (ImportError, ValueError, TypeError) as error:
        raise UsageError(f"{scrubbed(url)} cannot be used ({scrubbed(str(error))})") from None
    return filesystem, path


def known_scheme(url: str) -> bool:
    """Return whether fsspec supports the scheme of a URL, such as `s3`."""
    return url.partition("://")[0].lower() in _fsspec(url).available_protocols()


def _fsspec(url: str) -> Any:
    try:
        import fsspec
    except ImportError:
        raise UsageError(f"{scrubbed(url)}: {EXTRA}") from None
    return fsspec


@contextmanager
def remote_errors(shown: str, kind: type[StorageError]) -> Iterator[None]:
    """Turn errors of a storage library into a `CushionError` whose text has no credentials."""
    try:
        yield
    except CushionError:
        raise
    except FileNotFoundError:
        raise UsageError(f"{shown} does not exist; check bucket, folder and name") from None
    except Exception as error:
        said = scrubbed(f"{type(error).__name__}: {error}".removesuffix(": "))
        raise kind(f"{shown}: the storage failed ({said})") from None
