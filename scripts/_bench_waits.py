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
from amusic_baselines import make_policy

from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.extraction import BLOCK
from amusic_gym.extraction.map import DescribedMap
from amusic_gym.live.navigation import navigate
from amusic_gym.policies.protocol import Context
from amusic_gym.techniques import Technique, make_technique
from amusic_gym.worlds import Image, traverse

TECHNIQUES = ("hog", "cohog", "calc", "netvlad")
"""The paper's, whose speed is told: none needs a file or an optional part."""

ROOT = Path(__file__).resolve().parent.parent
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
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(statistic=statistic)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": paths},
    )
    return float(done.stdout)


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
    reference = large_map(make_technique("hog"), images, sizes.live_places)
    for prefix, statistic in STATISTICS.items():
        wall, own = drive(reference, images, sizes.live_frames, statistic)
        if not prefix:
            places = f"frames/s of subset:HOG in a map of {sizes.live_places} places"
            report("live_hog_frames_per_second", float(1e3 / np.median(wall)), places)
        what = f"ms per frame beyond the techniques, {statistic}"
        report(f"{prefix}live_overhead_ms", float(np.median(wall - own)), what)


def large_map(technique: Technique, images: list[Image], places: int) -> DescribedMap:
    """A map of so many places: the images' descriptors over and over, in memory."""
    described = np.stack([technique.describe(image) for image in images])
    at = np.arange(places) % len(described)
    return DescribedMap(technique, [described[at[i : i + BLOCK]] for i in range(0, places, BLOCK)])


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
