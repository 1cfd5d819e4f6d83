"""What the README and the pages beside it tell people to run exists, and its Python runs."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
import textwrap
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from env_cases import random_bank

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
COMMANDS = ROOT / "docs" / "commands.md"
PAGES = [README, *sorted((ROOT / "docs").rglob("*.md"))]

# The README trains for a minute; this shows only that it runs.
TINY = {"timesteps=300_000": "timesteps=64, n_envs=4, n_steps=8, pool=2, held_out=1"}


def commands(text: str) -> list[str]:
    """The lines to type: indented ones that begin with `make` or `python scripts/`."""
    joined = re.sub(r"\\\n\s*", "", text)
    found = re.findall(r"^ {4}.*?((?:make|python scripts/\S+)(?: .*)?)$", joined, re.MULTILINE)
    return found + re.findall(r"`((?:make|python scripts/\S+) [^`\n]+)`", joined)


def tasks() -> list[str]:
    """Every command of every page, once."""
    return list(dict.fromkeys(c for page in PAGES for c in commands(page.read_text("utf-8"))))


# Calls scripts, each in a process of its own that has what takes long to import already, but no
# module of this project; prints what they said as JSON.
CALLED = """
import json, os, runpy, sys, tempfile, traceback
import cv2, gymnasium, matplotlib, numba, scipy.stats, stable_baselines3, torch
said = []
for script, *words in json.loads(sys.argv[1]):
    with tempfile.TemporaryFile("w+") as output:
        child = os.fork()
        if not child:
            os.dup2(output.fileno(), 1)
            os.dup2(output.fileno(), 2)
            sys.path[0], sys.argv = os.path.dirname(script), [script, *words]
            status = 1
            try:
                runpy.run_path(script, run_name="__main__")
            except SystemExit as ended:
                status = ended.code
            except BaseException:
                traceback.print_exc()
            sys.stdout.flush()
            os._exit(status)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        output.seek(0)
        said.append((status, output.read()))
assert not any(name.startswith("amusic") for name in sys.modules)
print(json.dumps(said))
"""


def begins(command: str) -> list[tuple[str, ...]]:
    """What of a command has a ``--help``: its script, and with a subcommand both."""
    script, *arguments = shlex.split(command)[1:]
    is_subcommand = bool(arguments) and not arguments[0].startswith("-")
    return [(script,), (script, arguments[0])] if is_subcommand else [(script,)]


@cache
def helps() -> dict[tuple[str, ...], tuple[int, str]]:
    """Exit status and output of ``--help`` of every script and subcommand that a page names."""
    named = [each for task in tasks() if task.startswith("python") for each in begins(task)]
    calls = list(dict.fromkeys([*named, ("scripts/demo.py",)]))
    done = subprocess.run(
        [sys.executable, "-c", CALLED, json.dumps([[*call, "--help"] for call in calls])],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    return dict(zip(calls, json.loads(done.stdout), strict=True))


def help_of(*script: str) -> str:
    """What `python scripts/NAME.py [SUBCOMMAND] --help` prints."""
    status, said = helps()[script]
    assert status == 0, f"{' '.join(script)} --help: {said}"
    return said


def check_script(words: list[str]) -> None:
    """Refuse a call of a script that is not there or lacks a subcommand or an option."""
    script, *arguments = words
    assert (ROOT / script).is_file(), f"there is no {script}"
    where = [script]
    if arguments and not arguments[0].startswith("-"):  # a subcommand
        listed = re.search(rf"^ +{arguments[0]}( |$)", help_of(script), re.MULTILINE)
        assert listed, f"{script} has no {arguments[0]}"
        where.append(arguments[0])
    known = set(re.findall(r"--[\w-]+", help_of(*where)))
    named = {word for word in arguments if word.startswith("--")}
    assert named <= known, f"{' '.join(where)} has no {', '.join(sorted(named - known))}"


def check_make(words: list[str]) -> None:
    """Refuse a target or a variable that the Makefile lacks, or an option of `make demo`."""
    makefile = (ROOT / "Makefile").read_text("utf-8")
    target, *settings = words
    assert re.search(rf"^{target}:", makefile, re.MULTILINE), f"make has no target {target}"
    for setting in settings:
        variable, _, value = setting.partition("=")
        assert f"$({variable})" in makefile, f"make {target} knows no {variable}"
        if target == "demo" and variable == "ARGS":
            check_script(["scripts/demo.py", *shlex.split(value)])


def test_the_pages_name_the_two_commands_and_every_script() -> None:
    named = tasks()
    assert {"make demo", "make test"} <= set(named)
    scripts = {path.name for path in (ROOT / "scripts").glob("[!_]*.py")}
    assert scripts <= set(re.findall(r"scripts/(\w+\.py)", COMMANDS.read_text("utf-8")))


@pytest.mark.parametrize("command", tasks(), ids=lambda command: command[:60])
def test_command_exists(command: str) -> None:
    program, *words = shlex.split(command)
    if program == "make":
        check_make(words)
    else:
        check_script(words)


@pytest.mark.parametrize(
    "command",
    [
        "python scripts/nothing.py",
        "python scripts/nothing.py --out X",
        "python scripts/bank.py pictures --out X",
        "python scripts/bank.py simulate --seeds 1",
        "make nothing",
        "make setup NOTHING=1",
        'make demo ARGS="--nothing"',
    ],
)
def test_the_check_refuses_what_is_not_there(command: str) -> None:
    program, *words = shlex.split(command)
    with pytest.raises(AssertionError, match="no "):
        (check_make if program == "make" else check_script)(words)


def test_commands_are_found_in_blocks_and_in_sentences() -> None:
    text = (
        "\n    make demo\n    python scripts/b.py\n"
        "    A=1 python scripts/a.py --x \\\n        --y\n\nSee `make test -k`."
    )
    assert commands(text) == [
        "make demo",
        "python scripts/b.py",
        "python scripts/a.py --x --y",
        "make test -k",
    ]


def blocks() -> list[str]:
    """The Python of the README: of whoever trains, studies, and drives."""
    found = re.findall(r"^```python\n(.*?)^```", README.read_text("utf-8"), re.M | re.S)
    assert len(found) == 3
    return found


def test_the_readme_trains_as_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = blocks()[0]
    for long, short in TINY.items():
        assert code.count(long) == 1, f"the README no longer says {long}; say here what it says"
        code = code.replace(long, short)
    monkeypatch.chdir(tmp_path)
    values: dict[str, Any] = {}
    exec(compile(code, "README.md", "exec"), values)
    assert (tmp_path / "runs" / "first" / "selector.safetensors").is_file()
    assert values["info"]["ran"].tolist() == [True, False, False, False]


@pytest.mark.filterwarnings("ignore:.*has no correct match")
def test_the_readme_studies_as_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    random_bank(1, names=("HOG", "CALC", "CoHOG")).save(tmp_path / "banks" / "night")
    monkeypatch.chdir(tmp_path)
    exec(compile(blocks()[1], "README.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    line = r"{}: AUC [01]\.\d{{3}} \([01]\.\d{{3}}\), compute \d+%"
    for name, said in zip(("raw:HOG", "single:HOG", "music", "amusic"), lines, strict=False):
        assert re.fullmatch(line.format(name), said)
    assert len(lines) == 5


def test_the_readme_drives_as_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for seed, name in enumerate(("reference", "winter+night")):
        folder = tmp_path / "images" / name
        folder.mkdir(parents=True)
        for number in range(3):
            image = np.random.default_rng([seed, number]).integers(0, 256, (64, 64, 3))
            assert cv2.imwrite(str(folder / f"{number}.png"), image.astype(np.uint8))
    monkeypatch.chdir(tmp_path)
    exec(compile(blocks()[2], "README.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert all(re.fullmatch(r"[0-2] [01]\.\d\d( HOG)?( CoHOG)?", line) for line in lines)


def test_stable_baselines_learns_many_times_as_the_readme_says() -> None:
    import gymnasium as gym
    from stable_baselines3 import A2C, DQN, SAC, TD3

    code = r"^    from amusic_agents\.adapter.*?\.learn\(.*?\)$"
    found = re.search(code, COMMANDS.read_text("utf-8"), re.M | re.S)
    assert found
    code = textwrap.dedent(found[0])
    size = {name: int(re.search(rf"{name}=(\d+)", code)[1]) for name in ("num_envs", "n_steps")}  # type: ignore[index]
    frames = int(re.search(r"learn\(([\d_]+)\)", code)[1])  # type: ignore[index]
    assert frames >= 20 * size["num_envs"] * size["n_steps"]  # updates
    for long, short in (("num_envs=64", "num_envs=2"), ("n_steps=128", "n_steps=8, batch_size=8")):
        assert code.count(long) == 1
        code = code.replace(long, short)
    begin, last = code.rsplit("\n", 1)
    values: dict[str, Any] = {"gym": gym}
    exec(f"{begin}\nmodel = {last.replace(f'{frames:_}', '48')}", values)
    assert values["model"]._n_updates == 3 * values["model"].n_epochs
    env = values["model"].env
    assert A2C("MlpPolicy", env, n_steps=2).learn(8).num_timesteps == 8
    for other in (DQN, SAC, TD3):
        with pytest.raises(AssertionError, match="only supports"):
            other("MlpPolicy", env)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\((?!https?:|#)([^)#]+)[^)]*\)", page.read_text("utf-8"))
    missing = [link for link in links if not (page.parent / link).exists()]
    assert not missing, f"{page.name} links to {missing}"


def test_the_environment_is_made_as_the_readme_says() -> None:
    import gymnasium as gym

    text = README.read_text("utf-8")
    made = re.search(r'gym\.make_vec\("([^"]+)", num_envs=(\d+)\)', text)
    assert made
    env = gym.make_vec(made[1], num_envs=int(made[2]))
    assert env.num_envs == int(made[2])
    env.close()
