"""What is written to disk: whole, of one moment, with nobody else's files touched."""

from __future__ import annotations

import argparse
import itertools
import json
import os
import shutil
import stat
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from amusic_agents.config import ImitationConfig, RolloutConfig, TrainingConfig
from amusic_agents.run_folder import (
    CHECKPOINT,
    CONFIG,
    EVALUATIONS,
    SELECTOR,
    read_config,
    stored_config,
)
from amusic_agents.selector import load_selector
from amusic_agents.training import train
from comparison_cases import Lineup
from env_cases import random_bank
from safetensors.torch import load_file
from small_training import Quick, contents, small, small_rollouts

from amusic_gym.cli.parser import destination, page_folder
from amusic_gym.evaluation import plots
from amusic_gym.evaluation.comparison import compare
from amusic_gym.evaluation.figures import draw, write_page
from amusic_gym.evaluation.study.cells import MEASURED
from amusic_gym.evaluation.study.run import load_measures
from amusic_gym.extraction.code import key_of
from amusic_gym.routes.video import VideoWriter
from amusic_gym.utils import storage

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"


@pytest.fixture(autouse=True, scope="module")
def quick() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("amusic_agents.records.HeldOut", Quick)
        yield


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


class Killed(BaseException):
    """Ends a writer at once."""


def killed(work: Callable[[], Any], call: int) -> bool:
    """Whether ``work`` got as far as its ``call``-th rename, before which it was killed.

    What it has not finished stays, as after SIGKILL.
    """
    count, rename = itertools.count(1), os.replace

    def replace(source: Any, target: Any) -> None:
        if next(count) == call:
            raise Killed
        rename(source, target)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "replace", replace)
        patch.setattr(storage, "_remove", lambda path: None)  # the dead tidy nothing up
        patch.setattr(storage, "_swept", set())  # and the next process knows nothing of them
        try:
            work()
        except Killed:
            return True
        return False


def kills(
    work: Callable[[Path], Any], folder: Path, calls: Iterable[int] = itertools.count(1)
) -> Iterator[Path]:
    """A folder for every rename of ``work`` before which it is killed."""
    for call in calls:
        out = folder / f"{call}"
        if not killed(partial(work, out), call):
            assert call > 5, "it was killed at too few places"
            return
        yield out


# ---- killed at any rename -------------------------------------------------------------------


def test_27_a_comparison_killed_at_any_rename_is_finished_by_the_next_to_the_same_bytes(tmp_path):
    bank = random_bank(1, queries=12)

    def work(out: Path) -> None:
        compare([bank], Lineup("music", "single:T0"), out, report=len)

    work(tmp_path / "whole")
    for out in kills(work, tmp_path / "killed"):
        work(out)
        assert files(out) == files(tmp_path / "whole")


@pytest.fixture(scope="module")
def routes(tmp_path_factory) -> list[str]:
    folder = tmp_path_factory.mktemp("routes")
    return [str(random_bank(n, techniques=n, queries=14).save(folder / f"{n}")) for n in (2, 3)]


class Better(Quick):
    """Every selector is better than those before it."""

    def evaluate(self, selector, timesteps):
        return super().evaluate(selector, timesteps)._replace(score=float(timesteps))


def named_score(run: Path) -> float | None:
    """The score that ``config.json`` names, if any."""
    best = read_config(run)["best"] if (run / CONFIG).exists() else None
    return None if best is None else best["score"]


def test_35_policy_iteration_killed_at_any_rename_names_no_score_but_its_selector_s(
    tmp_path, routes, monkeypatch
):
    monkeypatch.setattr("amusic_agents.records.HeldOut", Better)
    config = small_rollouts(rollouts={"iterations": 2, "epochs": 1})
    scores: dict[bytes, float] = {}

    def work(out: Path) -> None:
        train(out, config, banks=routes, resume=(out / CONFIG).exists(), progress=False)

    def noting(*arguments: Any) -> None:
        write_config(*arguments)
        if (score := named_score(arguments[0])) is not None:
            scores[(arguments[0] / SELECTOR).read_bytes()] = score

    from amusic_agents.run_folder import write_config

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("amusic_agents.records.write_config", noting)
        work(tmp_path / "whole")
    for out in kills(work, tmp_path / "killed", range(8, 13)):  # at the second iteration's end
        if (score := named_score(out)) is not None:
            assert scores[(out / SELECTOR).read_bytes()] == score
        work(out)
        assert contents(out) == contents(tmp_path / "whole")


def test_35_ppo_killed_beside_its_selector_resumes_with_the_score_of_that(tmp_path, routes):
    def work(out: Path) -> None:
        config = small("ppo", timesteps=64, evaluate_every=32)
        train(out, config, banks=routes, resume=(out / CHECKPOINT).exists(), progress=False)

    for out in kills(work, tmp_path, range(6, 11)):  # at the first evaluation
        work(out)
        rows = (out / EVALUATIONS).read_text().splitlines()[1:]
        assert named_score(out) == max(float(row.split(",")[1]) for row in rows)
        best = load_file(out / CHECKPOINT)
        for name, tensor in load_file(out / SELECTOR).items():
            assert torch.equal(tensor, best[f"best.{name}"])
        assert not list(out.glob(".*"))


# ---- leftovers, locks, permissions ----------------------------------------------------------


def leave(folder: Path) -> Path:
    """A killed writer's file and folder, and an old hidden file of the user's."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / ".gitkeep").touch()
    os.utime(folder / ".gitkeep", (0, 0))
    (folder / ".amusic-0123456789abcdef.tmp.json").write_bytes(b"{")
    (folder / ".amusic-0123456789abcdef.tmp").mkdir()
    (folder / ".amusic-0123456789abcdef.tmp" / "scores.npy").touch()
    return folder


def test_27_leftovers_are_swept_wherever_something_is_written_and_nothing_else_is(tmp_path, routes):
    out = leave(tmp_path / "out")
    leave(out / "rows")
    leave(out / "traces")
    compare([random_bank(1, queries=12)], Lineup("music"), out, report=len)
    run = leave(tmp_path / "run")
    train(run, small("ppo", timesteps=32), banks=routes, progress=False)
    films = leave(tmp_path / "films")
    with VideoWriter(films / "a.avi", 5) as video:
        video.write(np.zeros((16, 16, 3), np.uint8))
    banks = leave(tmp_path / "banks")
    random_bank(1, queries=5).save(banks / "bank")
    for folder in (out, out / "rows", out / "traces", run, films, banks):
        hidden = {path.name for path in folder.glob(".*")}
        assert hidden - {".amusic-written.json"} == {".gitkeep"}, folder


def test_27_what_is_being_written_is_not_swept(tmp_path):
    with storage.replacing_file(tmp_path / "a") as temporary:
        storage.sweep(tmp_path)
        temporary.write_bytes(b"whole")
    assert files(tmp_path) == {"a": b"whole"}


def test_28_a_second_training_in_a_folder_is_refused(tmp_path, routes):
    with (
        storage.only_writer(tmp_path / "run"),
        pytest.raises(ValueError, match="run is in use by another process; wait for its end"),
    ):
        train(tmp_path / "run", small("ppo", timesteps=32), banks=routes, progress=False)
    assert not (tmp_path / "run").exists()  # nothing was written to it
    train(tmp_path / "run", small("ppo", timesteps=32), banks=routes, progress=False)
    with storage.only_writer(tmp_path / "run"), pytest.raises(ValueError, match="in use"):
        train(tmp_path / "run", small("ppo"), resume=True, progress=False)


def test_28_who_waits_for_a_lock_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "_PATIENCE", 0.05)
    holder = storage.locked(tmp_path)
    holder.__enter__()
    threading.Timer(0.3, holder.__exit__, (None, None, None)).start()
    with pytest.warns(UserWarning, match=f"waiting for the lock on {tmp_path}, which another"):
        random_bank(1, queries=5).save(tmp_path / "bank")


@pytest.mark.parametrize("umask", [0o077, 0o027, 0o022])
def test_27_files_and_folders_have_the_permissions_that_the_umask_gives(tmp_path, umask):
    before = os.umask(umask)
    try:
        storage.write_whole(tmp_path / "new" / "a.json", b"{}")
        random_bank(1, queries=5).save(tmp_path / "bank")
        with VideoWriter(tmp_path / "a.avi", 5) as video:
            video.write(np.zeros((16, 16, 3), np.uint8))
    finally:
        os.umask(before)
    for path in tmp_path.rglob("*"):
        wanted = (0o777 if path.is_dir() else 0o666) & ~umask
        assert stat.S_IMODE(path.stat().st_mode) == wanted, path


def test_27_a_full_disk_is_told_with_the_file_and_leaves_the_old_one(tmp_path, monkeypatch):
    path = storage.write_whole(tmp_path / "a.json", b"old")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match=r"a\.json failed \(No space left on device\); nothing was"):
        storage.write_whole(path, b"new")
    assert files(tmp_path) == {"a.json": b"old"}


# ---- --out used again -----------------------------------------------------------------------


def test_51_traces_and_figures_of_another_comparison_go_and_the_user_s_stay(tmp_path, monkeypatch):
    for name in ("front", "precision_recall", "selections", "shares"):
        monkeypatch.setattr(plots, name, lambda _, path: storage.write_whole(path, b"drawn"))
    first, second = random_bank(1, queries=12), random_bank(2, queries=12)
    first.name, second.name = "first", "second"
    for out, banks in ((tmp_path / "again", (first, second)), (tmp_path / "new", (second,))):
        for bank in banks:
            draw(compare([bank], Lineup("music", "cascade"), out, report=len), out)
            (out / "front-mine.png").write_bytes(b"mine")
            (out / "traces" / "mine.csv").write_bytes(b"mine")
    for folder in ("again", "new"):
        shutil.rmtree(tmp_path / folder / "rows")
    assert "traces/first-music.csv" not in files(tmp_path / "again")
    assert files(tmp_path / "again") == files(tmp_path / "new")
    assert files(tmp_path / "new")["front-mine.png"] == b"mine"


def test_51_only_named_files_within_the_folder_are_ever_removed(tmp_path):
    out = tmp_path / "out"
    for path in (tmp_path / "precious", out / "a", out / "b"):
        storage.write_whole(path, b"")
    names = ["../precious", str(tmp_path / "precious"), "a", ".", 7, None]
    for written in ({"figures": names}, {"figures": "a"}, [], {"traces": ["b"]}):
        storage.write_whole(out / ".amusic-written.json", json.dumps(written).encode())
        storage.keep_only(out, "figures", [])
    assert (tmp_path / "precious").exists()
    assert not (out / "a").exists()
    assert (out / "b").exists()


def test_51_a_page_of_the_user_s_own_is_refused_before_any_work(tmp_path):
    (tmp_path / "index.html").write_text("<!doctype html><title>mine</title>")
    with pytest.raises(argparse.ArgumentTypeError, match="is no page of amusic-gym; rename it"):
        page_folder(str(tmp_path))
    result = compare([random_bank(1, queries=12)], Lineup("music"), tmp_path / "out", report=len)
    page = write_page(result, tmp_path / "out")
    assert page_folder(str(page.parent)) == page.parent
    with pytest.raises(ValueError, match="is no page of amusic-gym"):
        write_page(result, tmp_path)
    assert "mine" in (tmp_path / "index.html").read_text()


def test_51_nothing_but_the_bank_is_written_to_a_bank_s_folder(tmp_path, monkeypatch, routes):
    bank = random_bank(1, queries=12)
    folder = bank.save(tmp_path / "m")
    before = files(folder)
    for out in (folder, folder / "sub" / "x"):
        for write in (
            lambda out=out: compare([bank], Lineup("music"), out, report=len),
            lambda out=out: train(out, small("ppo"), banks=routes, progress=False),
            lambda out=out: bank.save(out / "bank"),
        ):
            with pytest.raises(ValueError, match=r"in the folder of a score bank \(.*give another"):
                write()
        with pytest.raises(argparse.ArgumentTypeError, match="in the folder of a score bank"):
            destination(str(out))
    assert files(folder) == before
    bank.save(folder)


# ---- odd files ------------------------------------------------------------------------------

ODD = (None, -1, 10**300, "x", [[1]], {"a": 1})
RAW = (b"", b"[" * 10**5, b'{"a":' * 5000, b'{"a": Infinity}', b'{"a": 1' + b"0" * 400 + b"}",
       b"\xff", b"null", b"NaN", b"[1]")  # fmt: skip


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where the values within a JSON value are; of a list the first."""
    yield path
    inner = value.items() if isinstance(value, dict) else enumerate(value[:1]) if isinstance(
        value, list) else ()  # fmt: skip
    for key, item in inner:
        yield from places(item, (*path, key))


def changed(value: Any, path: tuple[Any, ...], odd: Any) -> Any:
    """A copy with another value in one place."""
    if not path:
        return odd
    made = dict(value) if isinstance(value, dict) else list(value)
    made[path[0]] = changed(value[path[0]], path[1:], odd)
    return made


def one_sentence(read: Callable[[], object]) -> None:
    """It works, or is refused in one line."""
    try:
        read()
    except ValueError as error:
        assert len(str(error).splitlines()) == 1  # noqa: PT017  (many odd values do no harm)


def test_23_odd_values_in_a_run_folder_are_refused_in_a_sentence(tmp_path, routes):
    train(tmp_path, small("ppo", timesteps=32), banks=routes, progress=False)
    config = tmp_path / CONFIG
    content = json.loads(config.read_bytes())
    for path, odd in itertools.product(places(content), ODD):
        config.write_text(json.dumps(changed(content, path, odd)))
        one_sentence(lambda: stored_config(tmp_path))
        if path[:1] == ("environment",):
            one_sentence(lambda: load_selector(tmp_path))
    for raw in RAW:
        config.write_bytes(raw)
        with pytest.raises(ValueError, match=r"config\.json is damaged .*; train the selector"):
            load_selector(tmp_path)


def test_23_odd_values_in_rows_and_cells_are_refused_in_a_sentence(tmp_path):
    bank = random_bank(1, queries=3)
    compare([bank], Lineup("music"), tmp_path, report=len)
    (path,) = (tmp_path / "rows").iterdir()
    body = json.loads(path.read_bytes())
    body.pop("checksum")
    cell = {"stem": "c", "measures": dict.fromkeys(MEASURED, 0.5)}

    def read_row() -> None:
        said: list[str] = []
        compare([bank], Lineup("music"), tmp_path, report=said.append)
        if "damaged" in said[0]:
            raise ValueError(said[0])

    def read_cell() -> None:
        measures = load_measures(tmp_path, "c")
        assert measures is not None
        assert set(measures) == set(MEASURED)

    for file, whole, read in ((path, body, read_row), (tmp_path / "c.json", cell, read_cell)):
        for where, odd in itertools.product(places(whole), ODD):
            made = changed(whole, where, odd)
            if isinstance(made, dict):
                made = {"checksum": key_of(**made), **made}
            file.write_text(json.dumps(made))
            one_sentence(read)
        for raw in RAW:
            file.write_bytes(raw)
            with pytest.raises(ValueError, match=r"\.json is damaged .*; delete it"):
                read()


@pytest.mark.parametrize("config", [ImitationConfig, RolloutConfig, TrainingConfig])
def test_23_all_numbers_of_a_training_are_checked_alike(config):
    for name, value in vars(config()).items():
        if type(value) not in (int, float):
            continue
        for odd in ("2", None, float("nan"), -1, True):
            with pytest.raises(ValueError, match=f"{name} is {odd!r}; give a (whole )?number"):
                config(**{name: odd})


# ---- what a terminal shows ------------------------------------------------------------------

SHOWN = """
import sys, warnings
sys.path.insert(0, sys.argv[1])
import _cli

def main():
    print("λ and \\udcff")
    warnings.warn("λ")
    raise ValueError("λ is wrong")

_cli.run(main)
"""


@pytest.mark.parametrize(
    ("encoding", "letter"), [("ascii", b"?"), ("latin-1", b"?"), ("utf-8", "λ".encode())]
)
def test_40_what_an_output_cannot_show_is_replaced(encoding, letter):
    done = subprocess.run(
        [sys.executable, "-c", SHOWN, SCRIPTS],
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": encoding},
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout == letter + b" and ?\n"
    assert done.stderr == b"warning: " + letter + b"\n-c: " + letter + b" is wrong\n"
