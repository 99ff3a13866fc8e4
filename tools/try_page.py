"""The page "Try it" as a folder of files: `python -m tools.try_page [--out FOLDER] [--serve]`."""

import argparse
import sys
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from os import PathLike
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from audioflinger_hook.monitor.try_page import content_type, page_files

OUT = Path(__file__).resolve().parents[1] / "out/site/try"
PORT = 8766


class Handler(SimpleHTTPRequestHandler):
    """Serves files of a folder with the media types of the page."""

    def guess_type(self, path: str | PathLike[str]) -> str:
        """Return the media type of a file."""
        return content_type(Path(path).name)

    def log_message(self, *_: object) -> None:
        """Write no line for each request."""


class Server(ThreadingHTTPServer):
    """Serves a browser that opens many connections at once."""

    request_queue_size = 64

    def handle_error(self, *asked: Any) -> None:
        """Say nothing of a browser that ends a download; it may do so."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(*asked)


def server(folder: Path, port: int) -> Server:
    """Return a server of a folder on this computer. port: 0 for any. OSError: it is in use."""
    return Server(("127.0.0.1", port), partial(Handler, directory=str(folder)))


def write(folder: Path) -> None:
    """Write all files of the page into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in page_files().items():
        (folder / name).write_bytes(content())


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page; with --serve, serve it until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--serve", action="store_true", help="serve the folder on this computer")
    parser.add_argument("--port", type=int, default=PORT)
    options = parser.parse_args(arguments)
    write(options.out)
    if not options.serve:
        print(f"{options.out}: any web server can serve this folder")
        return 0
    try:
        serving = server(options.out, options.port)
    except OSError as error:
        print(f"try: port {options.port}: {error.strerror}; give another --port", file=sys.stderr)
        return 1
    print(f"Open http://127.0.0.1:{serving.server_port}/ in a browser; Ctrl-C ends.", flush=True)
    with suppress(KeyboardInterrupt):
        serving.serve_forever()
    return 0


if __name__ == "__main__":
    sys.exit(main())
