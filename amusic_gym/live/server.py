"""Answers of a drive over HTTP: the last one, all as they come, and a page that shows them."""

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

from amusic_gym.live.answers import line
from amusic_gym.utils.closing import Closing

ALIVE = 15.0  # seconds without an answer after which a reader of events is told that all is well


class AnswerServer(Closing):
    """Serves ``/last`` (JSON; 204 before the first), ``/events`` and ``/``, in threads of its own.

    Who reads events slower than frames come misses some. Use it as a context manager.

    Args:
        port: 0 takes a free one.
        host: whose address is listened on; others than this machine can then read it, too.

    Attributes:
        url: of the page.
        last: the last answer; empty before the first.

    Raises:
        OSError: where that cannot be listened on.
    """

    def __init__(self, port: int, host: str = "127.0.0.1") -> None:
        self.last, self._number = b"", 0
        self._changed = threading.Condition()
        self._ended = False
        self._server = _Server((host, port), _Handler)
        self._server.answers = self
        self.url = f"http://{host}:{self._server.server_address[1]}/"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def put(self, answer: dict[str, Any]) -> None:
        """Publish a frame's answer."""
        with self._changed:
            self.last, self._number = line(answer).encode(), self._number + 1
            self._changed.notify_all()

    def after(self, number: int) -> tuple[int, bytes] | None:
        """The last answer and its number, once there is a later one; empty after `ALIVE` seconds.

        At the end it is None.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._number > number, ALIVE)
            if self._number > number:
                return self._number, self.last
            return None if self._ended else (number, b"")

    def close(self) -> None:
        """End all threads; twice is fine."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False  # a reader that has stopped reading must not keep the drive from ending
    answers: AnswerServer

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A reader that has gone is no error."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server

    def do_GET(self) -> None:  # noqa: N802
        answers, path = self.server.answers, self.path.partition("?")[0]
        if path == "/":
            page = files("amusic_gym.live").joinpath("page.html").read_bytes()
            self._send(200, "text/html; charset=utf-8", page)
        elif path == "/last":
            last = answers.last
            self._send(200 if last else 204, "application/json", last)
        elif path == "/events":
            self._begin(200, "text/event-stream")
            number = 0
            while (found := answers.after(number)) is not None:
                number, answer = found
                self.wfile.write(b"data: %s\n\n" % answer if answer else b": alive\n\n")
        else:
            self._send(404, "text/plain", b"there are /, /last and /events\n")

    def _begin(self, status: int, kind: str, *more: tuple[str, str]) -> None:
        self.send_response(status)
        for name, value in (("Content-Type", kind), ("Cache-Control", "no-store"), *more):
            self.send_header(name, value)
        self.end_headers()

    def _send(self, status: int, kind: str, content: bytes) -> None:
        self._begin(status, kind, ("Content-Length", str(len(content))))
        self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing: the drive has the terminal."""
