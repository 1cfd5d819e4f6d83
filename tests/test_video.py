"""Videos and cameras as frame sources, and videos written whole or not at all."""

from __future__ import annotations

import numpy as np
import pytest

from amusic_gym.envs.frames import FrameSource
from amusic_gym.routes.video import CODECS, Camera, VideoFile, VideoWriter

FRAMES = 7


def picture(i: int, size: tuple[int, int] = (64, 96)) -> np.ndarray:
    """Red grows and blue falls along the video; the codecs blur colours, hence so much of them."""
    return np.full((*size, 3), (30 * i, 20, 240 - 30 * i), np.uint8)


def write(path, frames: int = FRAMES):
    with VideoWriter(path, 10) as writer:
        for i in range(frames):
            writer.write(picture(i))
    return path


def number_of(image) -> int:
    """Which frame of :func:`write` an image is; its colours are blue, green, red."""
    assert image.shape == (64, 96, 3)
    assert image.dtype == np.uint8
    blue, _, red = image.reshape(-1, 3).astype(float).mean(axis=0)
    assert red + blue == pytest.approx(240, abs=16)
    return round(red / 30)


@pytest.fixture(params=sorted(CODECS))
def video(request, tmp_path):
    return write(tmp_path / f"drive{request.param}")


# ---- reading -----------------------------------------------------------------------------


def test_frames_come_back_in_order_and_the_last_one_tells_the_length(video):
    source = VideoFile(video)
    assert isinstance(source, FrameSource)
    assert source.name == "drive"
    assert not source.random_access
    for i in range(FRAMES):
        assert source.length is None
        assert number_of(source.read(i)) == i
    assert source.length == FRAMES
    assert source.read(FRAMES) is None
    source.close()
    source.close()


def test_frames_may_be_skipped_but_not_taken_back(video):
    source = VideoFile(video)
    assert number_of(source.read(3)) == 3
    with pytest.raises(ValueError, match=r"drive.*frame 3 has gone by.*rewind"):
        source.read(3)
    assert number_of(source.read(4)) == 4
    assert source.read(40) is None
    assert source.length == FRAMES
    source.rewind()
    assert number_of(source.read(0)) == 0


def test_a_frame_is_the_callers_own(video):
    source = VideoFile(video)
    first = source.read(0)
    kept = first.copy()
    source.read(1)
    np.testing.assert_array_equal(first, kept)


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"", "is empty"), (b"no video at all" * 40, "holds no frame that OpenCV can read")],
)
def test_what_is_no_video_is_refused_with_its_path_and_nothing_on_stderr(
    tmp_path, capfd, content, words
):
    path = tmp_path / "garbage.mp4"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"garbage\.mp4 {words}; give a video"):
        VideoFile(path)
    assert capfd.readouterr().err == ""


def test_a_missing_video_and_a_folder_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.mp4 does not exist"):
        VideoFile(tmp_path / "none.mp4")
    with pytest.raises(ValueError, match="is a folder; give a video file"):
        VideoFile(tmp_path)


def test_a_truncated_video_ends_or_is_refused(video):
    video.write_bytes(video.read_bytes()[: video.stat().st_size * 2 // 3])
    try:
        source = VideoFile(video)
    except ValueError as error:
        assert str(video) in str(error)  # noqa: PT017  (either is fine)
        return
    seen = [source.read(i) for i in range(FRAMES + 1)]
    assert seen[-1] is None
    assert source.length is not None
    assert source.length < FRAMES


class FakeCapture:
    """A camera that sees three grey pictures."""

    made: list[FakeCapture] = []

    def __init__(self, what) -> None:
        self.what, self.seen, self.released, self.settings = what, 0, False, {}
        self.made.append(self)

    def read(self):
        if self.what == 5 or self.seen == 4:
            return False, None
        self.seen += 1
        return True, np.full((4, 6), self.seen, np.uint8)

    def set(self, key, value) -> None:
        self.settings[key] = value

    def release(self) -> None:
        self.released = True


@pytest.fixture
def fake_camera(monkeypatch):
    FakeCapture.made = []
    monkeypatch.setattr("cv2.VideoCapture", FakeCapture)
    return FakeCapture


def test_a_camera_gives_what_it_sees_when_it_is_asked(fake_camera):
    camera = Camera(2)
    assert isinstance(camera, FrameSource)
    assert (camera.name, camera.length, camera.random_access) == ("camera 2", None, False)
    assert fake_camera.made[0].what == 2
    first = camera.read(0)
    assert first.shape == (4, 6, 3)  # grey cameras too
    camera.rewind()
    seen = [int(camera.read(i)[0, 0, 0]) for i in range(2)]
    assert seen == [first[0, 0, 0] + 1, first[0, 0, 0] + 2]
    assert camera.read(2) is None
    assert camera.length is None
    camera.close()
    assert fake_camera.made[0].released


def test_a_camera_keeps_no_old_pictures(fake_camera):
    import cv2

    Camera(0)
    assert fake_camera.made[0].settings[cv2.CAP_PROP_BUFFERSIZE] == 1


def test_a_camera_that_is_not_there_is_refused(fake_camera):
    with pytest.raises(OSError, match="camera 5 gives no picture; check that it is there"):
        Camera(5)
    with pytest.raises(ValueError, match="camera is -1"):
        Camera(-1)


def test_without_a_camera_the_real_one_is_refused_too(capfd):
    with pytest.raises(OSError, match="camera 63 gives no picture"):
        Camera(63)
    assert capfd.readouterr().err == ""


# ---- writing -----------------------------------------------------------------------------


def test_a_video_appears_under_its_name_only_when_it_is_whole(video):
    before = video.read_bytes()
    with VideoWriter(video, 10) as writer:
        writer.write(picture(0))
        assert video.read_bytes() == before
        assert len(list(video.parent.iterdir())) == 2
    assert [number_of(VideoFile(video).read(0))] == [0]
    assert VideoFile(video).read(1) is None
    assert list(video.parent.iterdir()) == [video]


@pytest.mark.parametrize("suffix", sorted(CODECS))
@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_a_video_is_valid_after_ctrl_c_and_errors(tmp_path, suffix, error):
    path = tmp_path / f"cut{suffix}"

    def cut() -> None:
        with VideoWriter(path, 10) as writer:
            for i in range(3):
                writer.write(picture(i))
            raise error

    with pytest.raises(error):
        cut()
    source = VideoFile(path)
    assert [number_of(source.read(i)) for i in range(3)] == [0, 1, 2]
    assert source.length == 3
    assert list(tmp_path.iterdir()) == [path]


def test_a_video_without_a_picture_leaves_the_old_file(video):
    before = video.read_bytes()
    with VideoWriter(video, 10):
        pass
    assert video.read_bytes() == before
    VideoWriter(video, 10).close()
    assert list(video.parent.iterdir()) == [video]


def test_strange_names_and_missing_folders_work(tmp_path):
    path = tmp_path / "new folder" / ("ü 北 " + 40 * "long ") / "straße.AVI"
    assert number_of(VideoFile(write(path)).read(0)) == 0


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("film.mp3", r"film\.mp3: unknown kind of video '\.mp3': did you mean '\.mp4'"),
        ("film", r"unknown kind of video '': valid: \.mp4, \.avi"),
        ("folder.mp4", "is a folder"),
    ],
)
def test_what_cannot_be_written_is_refused_at_once(tmp_path, name, words):
    (tmp_path / "folder.mp4").mkdir()
    with pytest.raises(ValueError, match=words):
        VideoWriter(tmp_path / name, 10)


def test_a_place_that_cannot_be_written_is_named(tmp_path, capfd):
    (tmp_path / "file").write_bytes(b"")
    with (
        pytest.raises(OSError, match="film.mp4|file"),
        VideoWriter(tmp_path / "file" / "film.mp4", 10) as writer,
    ):
        writer.write(picture(0))
    assert capfd.readouterr().err == ""


def test_pictures_of_another_size_are_refused(tmp_path):
    path = tmp_path / "film.avi"
    with VideoWriter(path, 10) as writer:
        writer.write(picture(0))
        with pytest.raises(ValueError, match=r"a picture of \(50, 40\) in a video of \(96, 64\)"):
            writer.write(picture(1, (40, 50)))
    assert VideoFile(path).read(1) is None
