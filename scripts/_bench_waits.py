"""What a user waits for: the import, the first step, a technique on an image, a live frame."""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from _bench_material import Sizes
from _cli import ROOT
from amusic_baselines import make_policy

from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.extraction import BLOCK
from amusic_gym.extraction.map import DescribedMap
from amusic_gym.live.navigation import navigate
from amusic_gym.policies.protocol import Context
from amusic_gym.techniques import make_technique
from amusic_gym.worlds import Image, traverse

TECHNIQUES = ("hog", "cohog", "calc", "netvlad")
"""The paper's, whose speed is told: none needs a file or an optional part."""

STATISTICS = {"": SICSettings.statistic, "belief_": "belief"}  # prefix of the keys → statistic

Report = Callable[[str, float, str], None]  # takes a key, its value, and a sentence on it

PROGRAM = """
import time
start = time.perf_counter()
import amusic_gym
statistic = {statistic!r}
if statistic:
    import gymnasium as gym
    env = gym.make("amusic_gym/TechniqueSelection-v0", statistic=statistic)
    start = time.perf_counter()
    env.reset(seed=0)
    env.step(env.action_space.sample())
print(time.perf_counter() - start)
"""


def seconds_of(statistic: str, cache: Path) -> float:
    """Seconds of the first reset and step in a process of its own; "": of the import."""
    command = [sys.executable, "-c", PROGRAM.format(statistic=statistic)]
    own = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    return float(subprocess.check_output(command, text=True, cwd=ROOT, env=own))


def measure_start(sizes: Sizes, report: Report) -> None:
    """The import and, per statistic, the first reset and step, cold (once) and cached."""
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder)
        imports = statistics.median(seconds_of("", cache) for _ in range(sizes.starts))
        report("import_seconds", imports, "s to import amusic_gym")
        for prefix, statistic in STATISTICS.items():
            own = cache / statistic
            cold = seconds_of(statistic, own)
            cached = statistics.median(seconds_of(statistic, own) for _ in range(sizes.starts))
            what = f"s to the first step with {statistic}, Numba's import included"
            report(f"{prefix}first_step_cold_seconds", cold, f"{what}, nothing compiled before")
            report(f"{prefix}first_step_cached_seconds", cached, f"{what}, compiled before")


def measure_images(sizes: Sizes, report: Report) -> None:
    """Describing an image by each technique, and live frames in a large map."""
    images = list(traverse(1, places=sizes.images, kind="street"))
    for name in TECHNIQUES:
        technique, seconds = make_technique(name), []
        for image in images[: sizes.rounds + 1]:
            start = time.perf_counter()
            technique.describe_query(image)
            seconds.append(time.perf_counter() - start)
        median = statistics.median(seconds[1:])  # the first one warms up
        report(f"{name}_describe_ms", 1e3 * median, "ms to describe a 320×240 query image")
    technique = make_technique("hog")
    described = np.stack([technique.describe(image) for image in images])  # over and over
    at = np.arange(sizes.live_places) % len(described)
    blocks = [described[at[i : i + BLOCK]] for i in range(0, at.size, BLOCK)]
    reference = DescribedMap(technique, blocks)
    for prefix, statistic in STATISTICS.items():
        wall, own = drive(reference, images, sizes.live_frames, statistic)
        if not prefix:
            places = f"frames/s of subset:HOG in a map of {sizes.live_places} places"
            report("live_hog_frames_per_second", float(1e3 / np.median(wall)), places)
        what = f"ms per frame beyond the techniques, {statistic}"
        report(f"{prefix}live_overhead_ms", float(np.median(wall - own)), what)


def drive(
    reference: DescribedMap, images: list[Image], count: int, statistic: str
) -> tuple[np.ndarray, np.ndarray]:
    """Milliseconds (count,) of each live frame and of its technique, after two that warm up."""
    frames = (images * (1 + count // len(images)))[: count + 2]
    route = LiveRoute([reference], frames, tolerance=2, seconds=[1.0])
    policy = make_policy("subset:HOG", Context.of(route, statistic=statistic))
    seen = list(navigate(policy, route, statistic=statistic))[2:]
    own = [one.run_milliseconds.sum() for one in seen]
    return np.array([one.milliseconds for one in seen]), np.array(own)
