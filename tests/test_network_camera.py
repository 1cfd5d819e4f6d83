"""A camera on the network: the newest picture, and on when it comes back."""

from __future__ import annotations

import itertools
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np
import pytest
from rtsp_camera import RtspCamera

from amusic_gym.routes import network_camera
from amusic_gym.routes.network_camera import NetworkCamera


class Mjpeg:
    """A camera that shows its pictures' numbers as brightness, over and over, until it stops."""

    scheme = "http"

    def __init__(self, port: int = 0) -> None:
        self.stopped = threading.Event()
        camera = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=part")
                self.end_headers()
                for number in itertools.count():
                    if camera.stopped.is_set():
                        return
                    image = np.full((32, 48, 3), 20 + number % 200, np.uint8)
                    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
                    head = f"--part\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}"
                    self.wfile.write(head.encode() + b"\r\n\r\n" + jpeg + b"\r\n")
                    time.sleep(0.01)

            def log_message(self, *_: object) -> None:
                pass

        class Server(ThreadingHTTPServer):
            daemon_threads = True

            def handle_error(self, *_: object) -> None:
                pass  # a reader that has gone

        self.server = Server(("127.0.0.1", port), Handler)
        self.port = self.server.server_address[1]
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def stop(self) -> None:
        self.stopped.set()
        self.server.shutdown()
        self.server.server_close()


@pytest.fixture(autouse=True)
def _soon(monkeypatch):
    monkeypatch.setattr(network_camera, "SILENT", 0.3)
    monkeypatch.setattr(network_camera, "PAUSE", 0.05)


def read_until(camera, is_enough):
    found = []
    for number in range(200):
        found.append(None if (image := camera.read(number)) is None else image.mean())
        if is_enough(image):
            break
    return found


@pytest.mark.parametrize("kind", [Mjpeg, RtspCamera])
def test_pictures_come_newest_first_and_go_on_when_the_camera_is_back(kind):
    server = kind()
    camera = NetworkCamera(f"{kind.scheme}://user:secret@127.0.0.1:{server.port}/cam")
    try:
        assert camera.name == "127.0.0.1/cam"
        first = camera.read(0)
        assert first.shape == (32, 48, 3)
        assert first.dtype == np.uint8
        time.sleep(0.5)  # a technique runs meanwhile
        assert int(camera.read(1).mean()) >= int(first.mean()) + 10
        server.stop()
        back = threading.Timer(1.0, lambda: setattr(camera, "again", kind(server.port)))
        back.start()
        with pytest.warns(UserWarning, match="camera 127.0.0.1/cam gives no picture"):
            given = read_until(camera, lambda image: hasattr(camera, "again"))
        assert None not in given
        assert camera.read(201) is not None
        camera.again.stop()
    finally:
        camera.close()
    assert not camera._thread.is_alive()


def test_one_that_stays_away_ends_the_drive(monkeypatch):
    monkeypatch.setattr(network_camera, "PATIENCE", 0.5)
    server = Mjpeg()
    camera = NetworkCamera(f"http://127.0.0.1:{server.port}/")
    server.stop()
    with pytest.warns(UserWarning, match=r"it is opened anew for 0\.5 s"):
        assert read_until(camera, lambda image: image is None)[-1] is None
    camera.close()


def test_what_is_no_camera_is_refused():
    server = Mjpeg()
    server.stop()
    with pytest.raises(OSError, match="camera 127.0.0.1/x gives no picture; check address"):
        NetworkCamera(f"http://a:b@127.0.0.1:{server.port}/x")
    with pytest.raises(ValueError, match="unknown kind of address 'ftp'"):
        NetworkCamera("ftp://127.0.0.1/x")


def test_navigate_drives_on_an_address(tmp_path, amusic):
    (tmp_path / "map").mkdir()
    for number in range(4):
        image = np.random.default_rng(number).integers(0, 255, (64, 64, 3), np.uint8)
        cv2.imwrite(str(tmp_path / "map" / f"img{number}.png"), image)
    server = Mjpeg()
    address = f"http://127.0.0.1:{server.port}/"
    words = ["--reference", tmp_path / "map", "--query", address, "--techniques", "hog"]
    code, out, err = amusic(
        "navigate", *words, "--policy", "music", "--frames", "3", "--seconds", "HOG=0.01",
        "--cache", tmp_path / "cache",
    )  # fmt: skip
    server.stop()
    assert code == 0, err
    assert out.startswith(" frame ")
    assert "3 frames, " in out
