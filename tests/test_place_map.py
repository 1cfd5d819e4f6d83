"""A map in one folder: the rows of extraction, refused by name where something has changed."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import numpy as np
import pytest
from extraction_cases import Tiny, TwoSided, make_images
from script_cases import run_and_stop

from amusic_gym.banks.bank_files import checksum
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.extraction import BLOCK, describe_map, extract
from amusic_gym.extraction import place_map as module
from amusic_gym.extraction.place_map import PlaceMap, append_to_map, build_map
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.positions import LOCAL, Positions

COUNT = BLOCK + 6
SPECS = ["extraction_cases:Tiny", "extraction_cases:TwoSided"]
SECONDS = {"Tiny": 0.5, "TwoSided": 0.25}


def line(count: int, first: int = 0) -> Positions:
    along = np.arange(first, first + count, dtype=float)
    return Positions(np.stack([along, 0 * along], 1), LOCAL, along, {}, "line")


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Folders ``map``, ``more`` and ``run``, and a map of the first in ``town.map``."""
    root = tmp_path_factory.mktemp("world")
    make_images(root / "map", COUNT)
    make_images(root / "more", 9, seed=2)
    make_images(root / "run", 12, seed=1)
    how = {"seconds": SECONDS, "cache": root / "cache", "positions": line(COUNT)}
    build_map(root / "map", SPECS, root / "town.map", **how)
    return root


@pytest.fixture
def town(world, tmp_path):
    """A copy of the map, to be spoiled."""
    copy = tmp_path / "town.map"
    copy.mkdir()
    for file in (world / "town.map").iterdir():
        (copy / file.name).write_bytes(file.read_bytes())
    return copy


def edited(town: Path, change) -> Path:
    manifest = json.loads((town / "map.json").read_text())
    change(manifest)
    manifest["sha256"] = checksum(manifest)
    (town / "map.json").write_text(json.dumps(manifest))
    return town


# ---- the same rows ---------------------------------------------------------------------------


def test_rows_are_those_of_extraction_bit_for_bit(world):
    found = PlaceMap.load(world / "town.map", threads=2)
    bank = extract(
        world / "map", world / "run", SPECS, tolerance=0, ground_truth=np.arange(12),
        seconds=SECONDS, cache=world / "cache",
    )  # fmt: skip
    assert (found.techniques, len(found)) == (("Tiny", "TwoSided"), COUNT)
    assert found.seconds.tolist() == bank.seconds.tolist()
    for query, image in enumerate(ImageFolder(world / "run")):
        for technique, one in enumerate(found.maps):
            row = one.scores(one.describe_query(image))
            assert row.tobytes() == bank.row(technique, query).tobytes()
    found.close()


def test_an_environment_on_the_map_is_that_on_the_images(world):
    maps = [describe_map(world / "map", spec, cache=world / "cache") for spec in SPECS]
    routes = [
        LiveRoute(each, world / "run", tolerance=1, seconds=[0.5, 0.25])
        for each in (maps, PlaceMap.load(world / "town.map").maps)
    ]
    envs = [TechniqueSelectionEnv(route) for route in routes]
    for env in envs:
        env.reset(seed=0)
    for step in range(12):
        one, other = (env.step([step % 2, 1]) for env in envs)
        np.testing.assert_array_equal(one[0], other[0])


def test_what_is_added_is_as_if_it_had_been_there(world, town):
    append_to_map(town, world / "more", cache=world / "cache", positions=line(9, COUNT))
    both = ImageFolder.join([ImageFolder(world / name) for name in ("map", "more")])
    build_map(both, SPECS, town.parent / "both.map", cache=world / "cache", seconds=SECONDS)
    one, other = (PlaceMap.load(town.parent / name, verify=True) for name in (town, "both.map"))
    for kind in ("descriptors-0.npy", "descriptors-1.npy", "thumbnails.npy", "ends.npy"):
        assert (town / kind).read_bytes() == (town.parent / "both.map" / kind).read_bytes()
    assert one.parts == other.parts == (COUNT, 9)
    assert len(one.names) == COUNT + 9
    assert one.positions is not None
    np.testing.assert_array_equal(one.positions.metres, line(COUNT + 9).metres)
    np.testing.assert_array_equal(one.positions.headings, line(COUNT + 9).headings)


def test_thumbnails_are_the_images_made_small(world, tmp_path):
    folder = make_images(tmp_path / "large", 2, size=(400, 640))
    build_map(folder, SPECS[:1], tmp_path / "m", seconds={"Tiny": 1}, cache=tmp_path / "c")
    found = PlaceMap.load(tmp_path / "m")
    assert found.thumbnails[1].shape == (200, 320, 3)
    assert len(found.thumbnails) == 2
    with pytest.raises(IndexError):
        found.thumbnails[2]
    small = PlaceMap.load(world / "town.map").thumbnails[3].astype(float)
    assert np.abs(small - ImageFolder(world / "map")[3]).mean() < 60


def test_the_same_call_writes_the_same_map(world, tmp_path):
    build_map(
        world / "map", SPECS, tmp_path / "again", positions=line(COUNT), seconds=SECONDS,
        cache=world / "cache", name="map",
    )  # fmt: skip
    for file in (world / "town.map").iterdir():
        assert file.read_bytes() == (tmp_path / "again" / file.name).read_bytes()


# ---- what has changed is refused by name -----------------------------------------------------


def test_25_a_changed_parameter_is_refused_by_name(town):
    words = r"technique 'Tiny' of the map .*town\.map was described with power 1\.0, here it is 2\."
    with pytest.raises(ValueError, match=words):
        PlaceMap.load(town, techniques=[Tiny(2.0)])
    PlaceMap.load(town, techniques=[Tiny(), TwoSided()])
    other = Tiny()
    other.name = "Other"
    with pytest.raises(ValueError, match="unknown technique 'Other'"):
        PlaceMap.load(town, techniques=[other])


def test_25_changed_code_and_class_are_refused_by_name(town):
    def code(manifest):
        manifest["techniques"][1]["identity"]["code"] = "0" * 64

    with pytest.raises(ValueError, match=r"'TwoSided' .* was described by other code than is here"):
        PlaceMap.load(edited(town, code))

    def kind(manifest):
        manifest["techniques"][0]["identity"]["class"] = "elsewhere.Tiny"

    with pytest.raises(ValueError, match=r"'Tiny' .* is of class elsewhere\.Tiny, here extraction"):
        PlaceMap.load(edited(town, kind))


def test_25_another_library_version_is_warned_of(town):
    def older(manifest):
        manifest["techniques"][0]["identity"]["libraries"]["numpy"] = "1.0"

    edited(town, older)
    with pytest.warns(UserWarning, match=r"'Tiny' .* was described with numpy 1\.0, here it is"):
        PlaceMap.load(town)


@pytest.mark.slow
def test_25_other_weights_are_refused_by_name(world, tmp_path):
    from amusic_gym.techniques.weight_files import shipped

    own = tmp_path / "own.safetensors"
    own.write_bytes(shipped("calc").read_bytes())
    how = {"seconds": {"CALC": 1}, "cache": world / "cache"}
    build_map(world / "more", ["calc"], tmp_path / "m", weights={"calc": own}, **how)
    assert PlaceMap.load(tmp_path / "m").techniques == ("CALC",)
    changed = bytearray(own.read_bytes())
    changed[-3] ^= 1
    own.write_bytes(changed)
    with pytest.raises(
        ValueError, match=r"'CALC' .* with weights '\w{64}', here it is .*--weights"
    ):
        PlaceMap.load(tmp_path / "m")
    PlaceMap.load(tmp_path / "m", weights={"calc": shipped("calc")})
    own.unlink()
    with pytest.raises(FileNotFoundError, match=r"own\.safetensors"):
        PlaceMap.load(tmp_path / "m")


# ---- damage ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["map.json", "descriptors-1.npy", "thumbnails.npy", "ends.npy", "positions.npy"]
)
def test_23_damage_is_detected(town, name):
    whole = (town / name).read_bytes()
    (town / name).write_bytes(whole[:-7])
    with pytest.raises(ValueError, match=f"{name} .*damaged"):
        PlaceMap.load(town)
    flipped = bytearray(whole)
    flipped[-3] ^= 1
    (town / name).write_bytes(flipped)
    with pytest.raises(ValueError, match=f"{name} .*damaged"):
        PlaceMap.load(town, verify=True)
    (town / name).unlink()
    with pytest.raises(FileNotFoundError, match=name):
        PlaceMap.load(town)


def test_29_a_newer_format_is_refused(town):
    with pytest.raises(ValueError, match=r"map .* has format version 9; it needs an amusic-gym"):
        PlaceMap.load(edited(town, lambda manifest: manifest.update(format_version=9)))


def test_27_a_map_that_cannot_be_written_leaves_the_old_one(town, world, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module.map_files, "write_floats", full)
    before = sorted(file.read_bytes() for file in town.iterdir())
    with pytest.raises(OSError, match="nothing was changed there"):
        append_to_map(town, world / "more", cache=world / "cache", positions=line(9))
    assert sorted(file.read_bytes() for file in town.iterdir()) == before
    assert [path.name for path in town.parent.iterdir()] == ["town.map"]


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"positions": None}, r"town\.map has positions; add images with their positions"),
        ({"positions": Positions(np.zeros((9, 3)), LOCAL, None, {}, "p")}, "cannot be compared"),
        ({"weights": {"hog": "x"}}, "unknown technique 'hog'"),
    ],
)
def test_what_does_not_fit_is_not_added(town, world, how, words):
    before = (town / "map.json").read_bytes()
    with pytest.raises(ValueError, match=words):
        append_to_map(town, world / "more", cache=world / "cache", **{"positions": line(9), **how})
    assert (town / "map.json").read_bytes() == before


def test_a_map_replaces_no_other_folder(world, tmp_path):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").touch()
    with pytest.raises(ValueError, match=r"holds other files \(mine\.txt\)"):
        build_map(world / "more", SPECS, tmp_path / "other", cache=tmp_path / "cache")
    with pytest.raises(ValueError, match="2 positions for 9 images"):
        build_map(world / "more", SPECS, tmp_path / "m", positions=line(2))
    with pytest.raises(ValueError, match="unknown technique 'Tyni': did you mean 'Tiny'"):
        build_map(world / "more", SPECS, tmp_path / "m", seconds={"Tyni": 1.0})
    with pytest.raises(ValueError, match="seconds of technique 'Tiny' are"):
        build_map(world / "more", SPECS, tmp_path / "m", seconds={"Tiny": -1.0})
    with pytest.raises(ValueError, match="Tiny"):
        build_map(world / "more", [Tiny(), Tiny()], tmp_path / "m")
    with pytest.raises(ValueError, match="0 techniques; give 1 to"):
        build_map(world / "more", [], tmp_path / "m")


# ---- the command -----------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_builds_appends_and_tells(amusic, world, tmp_path):
    town = tmp_path / "town.map"
    how = ["--cache", world / "cache"]
    positions = tmp_path / "p.csv"
    rows = [f"{at},{10 * at},0" for at in range(COUNT)]
    positions.write_text("\n".join(["frame,easting,northing", *rows]))
    built = ["build", world / "map", "--techniques", ",".join(SPECS), "--out", town]
    code, out, err = amusic("map", *built, *how, "--positions", positions, "--every-metres", 20)
    assert (code, err) == (0, "")
    assert f"{town}: 2 techniques, {COUNT // 2} places" in out
    code, out, err = amusic("map", "append", town, world / "more", "--positions", positions, *how)
    assert (code, err) == (0, "")
    code, out, err = amusic("map", "info", town)
    assert (code, err) == (0, "")
    assert f"places      {COUNT // 2} + 9\n" in out
    assert "easting and northing" in out
    assert "power 1.0" in out
    assert "not usable" not in out
    (town / "ends.npy").write_bytes(b"")
    code, _, err = amusic("map", "info", town)
    assert (code, err.count("\n")) == (2, 1)
    assert "ends.npy is damaged" in err


@pytest.mark.slow
def test_a_drive_on_the_map_is_that_on_its_images(amusic, world, tmp_path):
    drives = []
    for given in (
        ["--reference", world / "map", "--techniques", ",".join(SPECS), "--cache", world / "cache"],
        ["--map", world / "town.map"],
    ):
        trace = tmp_path / "trace.csv"
        how = ["--query", world / "run", "--policy", "amusic", "--trace", trace, "--quiet"]
        seconds = ["--seconds", "Tiny=0.5", "TwoSided=0.25"]
        code, _, err = amusic("navigate", *given, *how, *seconds)
        assert (code, err) == (0, "")
        drives.append([row.split(",")[:8] for row in trace.read_text().splitlines()])
    assert drives[0] == drives[1]


@pytest.mark.slow
def test_positions_of_the_map_say_what_is_right(amusic, world, tmp_path):
    (tmp_path / "q.csv").write_text("\n".join(["frame,x,y", *(f"{at},{at},0" for at in range(12))]))
    drive = ["--map", world / "town.map", "--query", world / "map", "--policy", "raw:Tiny"]
    drive += ["--frames", 12, "--quiet", "--within", 0.5]
    (tmp_path / "all.csv").write_text(
        "\n".join(["frame,x,y", *(f"{at},{at},0" for at in range(COUNT))])
    )
    code, out, err = amusic("navigate", *drive, "--query-positions", tmp_path / "all.csv")
    assert (code, err) == (0, "")
    assert "right places: 100.0%" in out
    for extra, words in (
        (["--techniques", "hog"], "--techniques does not go with --map"),
        (["--query", "0", "--every-metres", 2], "--every-metres needs a folder of images"),
        (["--query-positions", tmp_path / "q.csv"], "has no position of"),
        ([], "--within and --query-positions: what is right needs"),
    ):
        code, _, err = amusic("navigate", *drive, *extra)
        assert (code, err.count("\n")) == (2, 1)
        assert words in err


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_34_52_a_build_that_is_stopped_leaves_no_map_and_goes_on(world, tmp_path, number):
    how = ["build", world / "map", "--techniques", "hog,calc", "--seconds", "HOG=1", "CALC=1"]
    how += ["--out", tmp_path / "m", "--cache", tmp_path / "cache"]
    done = run_and_stop(number, 1, "map.py", *how)
    assert done.returncode == (130 if number == signal.SIGINT else 143)
    assert not (tmp_path / "m").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["cache"]
