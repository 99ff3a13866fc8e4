"""A server of the S3 API on loopback (moto's), which can be told to fail."""

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
from werkzeug.serving import WSGIRequestHandler, make_server

KEY, SECRET = "AKIATESTTESTTEST0001", "hidden-secret-of-the-test-0001"
BUCKET = "sounds"


class FailingServer:
    """The WSGI application of moto, which answers with the status codes of `failures`, one after
    the other, to requests (method, path) that `fails` chooses."""

    def __init__(self) -> None:
        self.failures: list[int] = []
        self.fails = lambda method, path: True
        self._works = DomainDispatcherApplication(create_backend_app)

    def __call__(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        method, path = environ["REQUEST_METHOD"], environ["PATH_INFO"]
        if self.failures and self.fails(method, path):
            status = self.failures.pop(0)
            environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
            name = {403: "InvalidAccessKeyId", 500: "InternalError", 503: "SlowDown"}[status]
            body = f"<Error><Code>{name}</Code><Message>refused {KEY}</Message></Error>".encode()
            head = [("Content-Type", "application/xml"), ("Content-Length", str(len(body)))]
            start_response(f"{status} {name}", head)
            return [] if method == "HEAD" else [body]
        found: Iterable[bytes] = self._works(environ, start_response)
        return found


class _Quiet(WSGIRequestHandler):  # type: ignore[misc, unused-ignore]
    def log(self, *_arguments: Any) -> None:
        """Print nothing."""


@contextmanager
def s3_server() -> Iterator[tuple[FailingServer, dict[str, str]]]:
    """Yield a server with an empty bucket, and the environment in which a client finds it."""
    application = FailingServer()
    server = make_server("127.0.0.1", 0, application, threaded=True, request_handler=_Quiet)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    env = {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{server.port}",
        "AWS_ACCESS_KEY_ID": KEY,
        "AWS_SECRET_ACCESS_KEY": SECRET,
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_EC2_METADATA_DISABLED": "true",
    }
    try:
        yield application, env
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
