"""A camera that speaks RTSP: motion JPEG (RFC 2435) interleaved in the connection (RFC 2326)."""

from __future__ import annotations

import itertools
import socketserver
import struct
import threading
import time

import cv2
import numpy as np

FRAGMENT = 1200
CLOCK = 90_000

SDP = "\r\n".join(
    [
        *("v=0", "o=- 1 1 IN IP4 127.0.0.1", "s=camera", "c=IN IP4 127.0.0.1", "t=0 0"),
        *("m=video 0 RTP/AVP 26", "a=control:track", ""),
    ]
)


def packets(jpeg: bytes, number: int, stamp: int) -> list[bytes]:
    """RTP packets of a baseline JPEG with 4:2:0 colours, the first being packet ``number``."""
    tables, at, height, width = b"", 2, 0, 0
    while True:
        marker, length = struct.unpack(">HH", jpeg[at : at + 4])
        body = jpeg[at + 4 : at + 2 + length]
        at += 2 + length
        if marker == 0xFFDB:
            tables += b"".join(body[first + 1 : first + 65] for first in range(0, len(body), 65))
        elif marker == 0xFFC0:
            height, width = struct.unpack(">HH", body[1:5])
        elif marker == 0xFFDA:
            break
    scan = jpeg[at:-2]
    found = []
    for first in range(0, len(scan), FRAGMENT):
        part, last = scan[first : first + FRAGMENT], first + FRAGMENT >= len(scan)
        head = struct.pack(
            ">BBHII", 0x80, 26 | 0x80 * last, (number + len(found)) % 2**16, stamp, 1
        )
        head += struct.pack(">II", first, 0x01FF0000 | width // 8 << 8 | height // 8)
        head += struct.pack(">HH", 0, len(tables)) + tables if first == 0 else b""
        found.append(head + part)
    return found


EXTRA = {
    "OPTIONS": "Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN\r\n",
    "DESCRIBE": "Content-Type: application/sdp\r\n",
    "SETUP": "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n",
}
"""Request → field of its answer."""


class Handler(socketserver.StreamRequestHandler):
    """One reader."""

    server: Server

    def handle(self) -> None:
        while request := self.request_of():
            method, sequence = request
            body = SDP if method == "DESCRIBE" else ""
            self.wfile.write(
                f"RTSP/1.0 200 OK\r\nCSeq: {sequence}\r\nSession: 1\r\n{EXTRA.get(method, '')}"
                f"Content-Length: {len(body)}\r\n\r\n{body}".encode()
            )
            if method == "PLAY":
                self.play()
                return

    def request_of(self) -> tuple[str, str] | None:
        """Method and number of the next request."""
        lines = []
        while line := self.rfile.readline().decode().strip():
            lines.append(line)
        fields = dict(line.split(": ", 1) for line in lines[1:])
        return (lines[0].split()[0], fields["CSeq"]) if lines else None

    def play(self) -> None:
        sent, begun = 0, time.monotonic()
        for number in itertools.count():
            if self.server.stopped.is_set():
                return
            image = np.full((32, 48, 3), 20 + number % 200, np.uint8)
            stamp = int(CLOCK * (time.monotonic() - begun)) % 2**32
            for packet in packets(cv2.imencode(".jpg", image)[1].tobytes(), sent, stamp):
                self.wfile.write(struct.pack(">cBH", b"$", 0, len(packet)) + packet)
                sent += 1
            time.sleep(0.01)


class Server(socketserver.ThreadingTCPServer):
    """The camera's side of all connections."""

    daemon_threads = allow_reuse_address = True

    def __init__(self, port: int) -> None:
        self.stopped = threading.Event()
        super().__init__(("127.0.0.1", port), Handler)

    def handle_error(self, *_: object) -> None:
        pass  # a reader that has gone


class RtspCamera:
    """A camera that shows its pictures' numbers as brightness, over and over, until it stops.

    Args:
        port: of 127.0.0.1; 0: a free one, which is the attribute.
    """

    scheme = "rtsp"

    def __init__(self, port: int = 0) -> None:
        self.server = Server(port)
        self.port = self.server.server_address[1]
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def stop(self) -> None:
        self.server.stopped.set()
        self.server.shutdown()
        self.server.server_close()
