"""Positions of images: their distances, the files that say them, and what is true within metres."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from image_cases import picture
from PIL import Image as Pillow

from amusic_gym.routes import image_truth
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.position_files import positions_of, read_track
from amusic_gym.routes.positions import (
    GEOGRAPHIC,
    LOCAL,
    PROJECTED,
    Positions,
    check_comparable,
    from_degrees,
    from_names,
    in_a_plane,
)

OSLO = (59.9139, 10.7522)


def folder_of(path: Path, names: list[str]) -> ImageFolder:
    path.mkdir(parents=True)
    for at, name in enumerate(names):
        Pillow.fromarray(picture(seed=at)).save(path / name)
    return ImageFolder(path)


def numbered(path: Path, count: int = 5) -> ImageFolder:
    return folder_of(path, [f"{at:03}.png" for at in range(count)])


def table(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


# ---- distances -----------------------------------------------------------------------------


def test_distances_of_latitude_and_longitude_are_those_of_the_ellipsoid():
    """Vincenty's inverse of published pairs: a degree along the equator and the meridian."""
    degree = from_degrees([0.0, 0.0, 1e-3], [0.0, 1e-3, 0.0])
    track = Positions(degree, GEOGRAPHIC, None, {}, "t")
    east, north = track.distances(degree[0])[1:]
    assert east == pytest.approx(111.319491, abs=1e-5)
    assert north == pytest.approx(110.574273, abs=2e-5)
    seam = from_degrees([12.0, 12.0], [179.9999, -179.9999])
    assert np.linalg.norm(seam[0] - seam[1]) < 22


@given(st.floats(-89, 89), st.floats(-179.9, 179.9))
def test_degrees_come_back(north, east):
    track = Positions(from_degrees([north], [east]), GEOGRAPHIC, None, {}, "t")
    found = track.degrees()
    assert found is not None
    np.testing.assert_allclose(found[0], (north, east), atol=1e-9)


def test_a_plane_keeps_distances_and_puts_north_up():
    metres = from_degrees(OSLO[0] + np.array([0, 1e-3, 0]), OSLO[1] + np.array([0, 0, 1e-3]))
    track = Positions(metres, GEOGRAPHIC, None, {}, "t")
    (plane,) = in_a_plane(track)
    flat = np.linalg.norm(plane - plane[0], axis=1)
    np.testing.assert_allclose(flat, track.distances(metres[0]), atol=1e-2)
    assert plane[1, 1] - plane[0, 1] > 100
    assert plane[2, 0] - plane[0, 0] > 50
    poses = Positions(np.array([[0.0, 5, 1], [9, 5, 3], [1, 6, 30]]), LOCAL, None, {}, "t")
    assert np.ptp(in_a_plane(poses)[0], axis=0).tolist() == [9, 29]  # y hardly changes


def test_every_metres_takes_the_next_image_far_enough_on():
    along = np.array([0.0, 1, 1.9, 2, 2.1, 5, 5.5, 4.5, 9])
    track = Positions(np.stack([along, along * 0], 1), LOCAL, None, {}, "t")
    assert track.every(2).tolist() == [0, 3, 5, 8]
    for wrong in (0, -1, math.nan):
        with pytest.raises(ValueError, match="give a distance above 0"):
            track.every(wrong)


# ---- files ---------------------------------------------------------------------------------


def test_a_table_names_images_with_or_without_folder_and_suffix(tmp_path):
    folder = numbered(tmp_path / "map", 3)
    path = table(
        tmp_path / "p.csv",
        "# of a receiver",
        "File; LAT; Lon; Heading",
        "map/002.png; 59.9141; 10.7522; 350",
        "000; 59.9139; 10.7522; 10.5",
        "001.png; 59.9140; 10.7522; 0",
        "999.png; 1; 1; 1",
    )
    found = positions_of(path, folder)
    assert (found.system, len(found)) == (GEOGRAPHIC, 3)
    assert found.headings is not None
    assert found.headings.tolist() == [10.5, 0, 350]
    np.testing.assert_allclose(found.distances(found.metres[0]), [0, 11.14, 22.28], atol=0.01)


def test_a_table_of_frames_and_one_of_times_lie_between_their_rows(tmp_path):
    path = table(tmp_path / "p.csv", "frame,easting,northing,heading", "0,10,0,350", "4,14,8,10")
    found = positions_of(path, numbered(tmp_path / "map"))
    assert found.metres.tolist() == [[10, 0], [11, 2], [12, 4], [13, 6], [14, 8]]
    assert found.headings is not None
    assert found.headings[2] == pytest.approx(0, abs=1e-9)
    assert found.system == PROJECTED
    stamped = folder_of(tmp_path / "t", ["1305031102.25.png", "1305031103.0.png"])
    nano = table(
        tmp_path / "n.csv", "time,x,y", "1305031102000000000,0,0", "1305031103000000000,4,2"
    )
    assert positions_of(nano, stamped).metres.tolist() == [[1, 0.5], [4, 2]]


def test_left_out_images_keep_their_numbers(tmp_path):
    folder = numbered(tmp_path / "map").without({1, 2})
    path = table(tmp_path / "p.csv", "index,x,y", *(f"{at},{at},0" for at in range(5)))
    assert positions_of(path, folder).metres[:, 0].tolist() == [0, 3, 4]
    kitti = table(tmp_path / "k.txt", *(f"1 0 0 {at} 0 1 0 0 0 0 1 0" for at in range(5)))
    assert positions_of(kitti, folder).metres[:, 0].tolist() == [0, 3, 4]


def turned(degrees: float) -> np.ndarray:
    """KITTI's pose of a camera that looks so far to the right of where z points."""
    sine, cosine = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    return np.array([[cosine, 0, sine, 1], [0, 1, 0, 2], [-sine, 0, cosine, 3]])


def test_poses_of_kitti_and_tum_have_headings_clockwise(tmp_path):
    lines = [" ".join(map(str, turned(angle).ravel())) for angle in (0, 90, -30)]
    kitti = read_track(table(tmp_path / "k.txt", *lines)).positions
    assert kitti.system == LOCAL
    assert kitti.metres.tolist() == [[1, 2, 3]] * 3
    np.testing.assert_allclose(kitti.headings, [0, 90, -30], atol=1e-9)
    half = math.radians(-90) / 2  # a quarter to the right, seen from above
    tum = table(
        tmp_path / "tum.txt",
        "# timestamp tx ty tz qx qy qz qw",
        "1.0 1 2 3 0 0 0 1",
        f"2.0 3 4 5 0 0 {math.sin(half)} {math.cos(half)}",
    )
    track = read_track(tum)
    np.testing.assert_allclose(track.positions.headings, [0, 90], atol=1e-9)
    found = track.of_images(folder_of(tmp_path / "t", ["1.5.png", "2.5.png"]))
    assert found.metres.tolist() == [[2, 3, 4], [3, 4, 5]]  # the last within a second of a pose


def test_exif_says_where_an_image_was_taken(tmp_path):
    folder = tmp_path / "map"
    folder.mkdir()
    for at, east in enumerate(("E", "W")):
        image = Pillow.fromarray(picture(seed=at))
        exif = Pillow.Exif()
        gps = {1: "S", 2: (59.0, 54.0, 50.04), 3: east, 4: (10.0, 45.0, 7.92), 17: 12.5}
        exif[0x8825] = gps
        image.save(folder / f"{at}.jpg", exif=exif)
    found = positions_of("exif", ImageFolder(folder))
    degrees = found.degrees()
    assert degrees is not None
    np.testing.assert_allclose(degrees, [(-OSLO[0], OSLO[1]), (-OSLO[0], -OSLO[1])], atol=1e-7)
    assert found.headings is not None
    assert found.headings.tolist() == [12.5, 12.5]
    with pytest.raises(ValueError, match=r"EXIF data has no position of 3 images: 000\.png, 001"):
        positions_of("exif", numbered(tmp_path / "bare", 3))


# ---- refusals ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([""], "holds no position"),
        (["name,lat,lon"], "holds no position"),
        (
            ["name,lat,lon", "000.png,59,10"],
            r"no position of 4 images.*: 001\.png, 002\.png, 003\.png",
        ),
        (["lat,lon", "59,10"], "which image a position is of; add a column 'name', 'frame' or"),
        (["name,heading", "0,1"], "names no position; give two columns named latitude and"),
        (["name,lat,lon,east,north", "0,1,1,2,2"], "gives latitude and longitude as well as east"),
        (["name,lat,lon", "0,6955000,500000"], r"latitude 6955000\.0, .* name the columns north"),
        (["name,lat,lon", "0,0,0"], "what receivers write without a fix .*row 0.*drop these"),
        (["name,lat,lon", "0,x,10"], "line 2: latitude 'x' is no number"),
        (["name,lat,lon", "0,1"], "line 2: 2 columns, fewer than its first line has"),
        (["frame,x,y", "0,1,1", "0,2,2"], "row 1 is of frame 0, after 0; sort the rows"),
        (["frame,x,y", "0,1,1", "3,2,2"], r"no position of 1 images.*: 004\.png; add them"),
        (["time,x,y", "0,1,1", "9,2,2"], r"no position of 3 images.*: 002\.png"),
        (["1 2 3", "4 5 6"], "lines of 3 fields and no names of columns"),
        (["1 0 0 4 0 1 0 0 0 0 1 0"], "has 1 positions without names, for 5 images"),
    ],
)
def test_45_files_that_say_no_positions_are_refused(tmp_path, lines, words):
    path = table(tmp_path / "p.csv", *lines)
    with pytest.raises(ValueError, match=words):
        positions_of(path, numbered(tmp_path / "map"))


def test_45_positions_by_time_need_names_that_are_times(tmp_path):
    path = table(tmp_path / "p.csv", "time,x,y", "0,1,1")
    with pytest.raises(ValueError, match="has names such as img0 that are no time; add a column"):
        positions_of(path, folder_of(tmp_path / "map", ["img0.png", "img1.png"]))
    with pytest.raises(FileNotFoundError, match=r"no\.csv does not exist"):
        positions_of(tmp_path / "no.csv", numbered(tmp_path / "other"))


def test_45_systems_and_zones_are_compared(tmp_path):
    here, there = numbered(tmp_path / "r", 3), numbered(tmp_path / "q", 3)

    def at(name: str, columns: str, *rows: str) -> Positions:
        lines = [f"{number:03},{row}" for number, row in enumerate(rows)]
        path = table(tmp_path / f"{name}.csv", f"name,{columns}", *lines)
        return positions_of(path, here)

    degrees = at("deg", "lat,lon", "59,10", "59.1,10", "59.2,10")
    metres = at("met", "easting,northing,zone", *(f"{i}00,6955000,32V" for i in range(3)))
    other = at("oth", "easting,northing,zone", *(f"{i}00,6955000,33 W" for i in range(3)))
    poses = at("xyz", "x,y,z", "0,0,0", "1,0,0", "2,0,0")
    with pytest.raises(ValueError, match=r"deg\.csv gives latitude and .*met\.csv easting and nor"):
        image_truth.by_position(here, there, positions=(degrees, metres))
    with pytest.raises(ValueError, match="different UTM zones: 32 north .*, 33 north"):
        image_truth.by_position(here, there, positions=(metres, other))
    with pytest.raises(ValueError, match="cannot be compared"):
        check_comparable(poses, metres)
    named = at("nam", "easting,northing", *(f"10.{i},59.9" for i in range(3)))
    with pytest.raises(ValueError, match="look like degrees"):
        check_comparable(named, named)
    near = image_truth.by_position(here, there, 1.0, positions=(poses, poses))
    assert near.matrix().tolist() == [[1, 1, 0], [1, 1, 1], [0, 1, 1]]
    with pytest.raises(ValueError, match="does not say in which direction it looks"):
        image_truth.by_position(here, there, 1.0, heading=10, positions=(poses, poses))


def test_names_and_files_give_the_same_truth(tmp_path):
    names = [f"@{500000 + 10 * i}@6955000@32@V@@@{i}@@{i}@.png" for i in range(6)]
    folder = folder_of(tmp_path / "map", names)
    rows = [f"{name},{500000 + 10 * i},6955000" for i, name in enumerate(names)]
    given = positions_of(table(tmp_path / "p.csv", "name,east,north", *rows), folder)
    np.testing.assert_array_equal(given.metres, from_names(folder).metres)
    one = image_truth.by_position(folder, folder, 20)
    other = image_truth.by_position(folder, folder, 20, positions=(given, given))
    np.testing.assert_array_equal(one.matrix(), other.matrix())
    assert one.half_run() == 2


def test_joined_tracks_are_those_of_both_and_comparable_only(tmp_path):
    one = Positions(np.zeros((2, 2)), LOCAL, np.zeros(2), {}, "one")
    other = Positions(np.ones((3, 2)), LOCAL, None, {}, "other")
    both = one.joined(other)
    assert (len(both), both.headings) == (5, None)
    with pytest.raises(ValueError, match="cannot be compared"):
        one.joined(Positions(np.ones((3, 3)), GEOGRAPHIC, None, {}, "globe"))
