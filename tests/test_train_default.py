"""The trainings of the selectors that ship, at a small size, and what may take their place."""

from __future__ import annotations

import hashlib
import json
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import pytest
from amusic_agents.config import RolloutConfig, TrainingConfig
from amusic_agents.run_folder import CONFIG, SELECTOR
from amusic_agents.selector import load_selector
from amusic_agents.shipped import PRETRAINED, shipped
from small_training import SCRIPTS, SMALL

from amusic_gym.cli import status

if str(SCRIPTS) not in sys.path:
    sys.path.insert(0, str(SCRIPTS))  # the training, as the scripts find each other

import train_default  # noqa: E402  (found by the lines above)

pytestmark = pytest.mark.slow

TINY = {
    **SMALL,
    "rollouts": RolloutConfig(
        iterations=2, states=8, subsets=4, hold=2, horizon=6, every=3, epochs=2, batch_size=4
    ),
    "threads": 1,  # processes would not know of the small size
}
CARD = "CARD.md"


def digests(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(autouse=True)
def nothing_is_written_where_the_selector_ships():
    before = digests(PRETRAINED)
    yield
    assert digests(PRETRAINED) == before


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """Runs the command at a small size; what ships is in a folder of the test."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "amusic_agents.config.TrainingConfig", lambda **v: TrainingConfig(**{**v, **TINY})
        )

        def call(out: Path, folder: Path, *more: object) -> None:
            patch.setattr(train_default, "shipped", lambda statistic, allow_idle: folder)
            train_default.main([str(word) for word in ("--out", out, *more)])

        yield call


@pytest.fixture(scope="module")
def trained(command, tmp_path_factory) -> SimpleNamespace:
    """A tiny training for the default statistic that shipped into an empty folder with a card."""
    folder = tmp_path_factory.mktemp("default")
    shipped = folder / "shipped"
    shipped.mkdir()
    (shipped / CARD).write_text("by hand")
    command(folder / "run", shipped, "--ship")
    return SimpleNamespace(out=folder / "run", shipped=shipped)


@pytest.fixture(scope="module")
def belief(command, tmp_path_factory) -> SimpleNamespace:
    """A tiny training for the statistic belief that shipped into an empty folder."""
    folder = tmp_path_factory.mktemp("belief")
    (folder / "shipped").mkdir()
    command(folder / "run", folder / "shipped", "--statistic", "belief", "--ship")
    return SimpleNamespace(out=folder / "run", shipped=folder / "shipped")


@pytest.fixture
def better(tmp_path) -> Path:
    """A folder that holds the real selector."""
    folder = tmp_path / "better"
    folder.mkdir()
    for name in (SELECTOR, CONFIG, CARD):
        source = PRETRAINED if name == CARD else shipped()
        (folder / name).write_bytes((source / name).read_bytes())
    return folder


@pytest.mark.parametrize("statistic", ["evidence", "belief"])
def test_a_run_ships_a_selector_that_loads_with_its_configuration(trained, belief, statistic):
    run = belief if statistic == "belief" else trained
    files = [CONFIG, SELECTOR] if statistic == "belief" else [CARD, CONFIG, SELECTOR]
    assert sorted(digests(run.shipped)) == files
    assert train_default.is_same(run.out, run.shipped)
    text = (run.shipped / CONFIG).read_text("utf-8")
    stored = json.loads(text)
    assert stored["training"]["algorithm"] == "rollouts"
    assert stored["training"]["reward"] == "ground_truth"
    assert stored["banks"] == []
    assert stored["best"]["timesteps"] in (8, 16)  # states of one iteration, or of both
    assert str(run.out) not in text  # no machine's path
    load_selector(run.shipped)


def test_the_card_stays_as_it_is(trained):
    assert (trained.shipped / CARD).read_text() == "by hand"


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(
    trained, command, tmp_path, capsys
):
    (tmp_path / "empty").mkdir()
    command(tmp_path / "again", trained.shipped)
    assert capsys.readouterr().out.endswith("is the selector that ships for 'evidence'\n")
    command(tmp_path / "again", tmp_path / "empty", "--ship")  # trained already
    for name in (SELECTOR, CONFIG):
        assert (tmp_path / "empty" / name).read_bytes() == (trained.shipped / name).read_bytes()
    capsys.readouterr()
    before = digests(trained.shipped)
    command(tmp_path / "other", trained.shipped, "--seed", 1)
    told = capsys.readouterr().out
    assert told.endswith("is not the selector that ships for 'evidence', bit for bit\n")
    assert digests(trained.shipped) == before  # nothing ships unless asked


def test_the_statistic_is_the_default_s_or_the_one_that_is_asked_for(
    trained, belief, command, tmp_path, capsys
):
    stored = json.loads((trained.shipped / CONFIG).read_text("utf-8"))
    assert stored["versions"]["statistic"] == "evidence"
    assert stored["environment"] == {"carry": True, "discount": True}
    stored = json.loads((belief.shipped / CONFIG).read_text("utf-8"))
    assert stored["versions"]["statistic"] == "belief"
    assert stored["environment"] == {"carry": False, "discount": False}
    with pytest.raises(SystemExit):
        command(tmp_path / "mean", tmp_path / "empty", "--statistic", "mean")
    assert "invalid choice: 'mean'" in capsys.readouterr().err


@pytest.mark.parametrize("statistic", ["evidence", "belief"])
def test_a_finished_training_is_not_begun_again(
    trained, belief, command, monkeypatch, capsys, statistic
):
    run = belief if statistic == "belief" else trained
    before = digests(run.out)
    for name in ("collect", "learn"):
        monkeypatch.setattr(f"amusic_agents.policy_iteration.{name}", None)
    command(run.out, run.shipped, "--statistic", statistic)
    assert capsys.readouterr().out.endswith(f"is the selector that ships for {statistic!r}\n")
    assert digests(run.out) == before


def test_a_worse_selector_does_not_take_the_place_of_a_better_one(
    trained, command, better, capsys, monkeypatch
):
    before = digests(better)
    monkeypatch.setattr(train_default, "score", lambda run, routes: float(run == better))
    monkeypatch.setattr(sys, "argv", ["train_default.py"])
    monkeypatch.setattr("warnings.formatwarning", warnings.formatwarning)  # run() replaces it
    with pytest.raises(SystemExit) as ended:
        status.run(lambda: command(trained.out, better, "--ship"))
    told = capsys.readouterr()
    assert ended.value.code == 2
    message = told.err.splitlines()[-1]  # after a progress bar
    assert message.startswith(f"train_default.py: the selector in {better} reaches a score of ")
    assert "leave out --ship, or delete" in message
    assert digests(better) == before
    (better / SELECTOR).unlink()  # as the message says
    monkeypatch.undo()
    command(trained.out, better, "--ship")
    assert train_default.is_same(trained.out, better)


def test_a_better_selector_takes_the_place_and_so_does_one_of_the_same_score(
    trained, better, tmp_path, monkeypatch
):
    place = tmp_path / "place"
    place.mkdir()
    monkeypatch.setattr(train_default, "score", lambda run, routes: float(run == better))
    train_default.ship(trained.out, place)
    train_default.ship(better, place)
    assert train_default.is_same(better, place)
    monkeypatch.setattr(train_default, "score", lambda run, routes: 0.5)
    train_default.ship(trained.out, place)
    assert train_default.is_same(trained.out, place)


def test_a_selector_that_cannot_be_run_is_replaced(trained, better, capsys):
    config = json.loads((better / CONFIG).read_text("utf-8"))
    config["versions"]["network"] = 0
    (better / CONFIG).write_text(json.dumps(config))
    train_default.ship(trained.out, better)
    assert "network version 0" in capsys.readouterr().out
    assert train_default.is_same(trained.out, better)
    load_selector(better)
