"""Measure the speed, as ratios of two sides in one run; print a table and write a JSON object.

    python scripts/bench.py --out FILE.json

The sides take turns, after one warm-up, on one thread unless it says two; each figure is a median.
SIC is compared with NumPy's gather before it is timed. All with the statistic `evidence`, γ = 1,
nothing carried on and no discount, unless it says so. And what a user waits for, with the defaults,
which is this machine's: import_seconds, first_step_cold_seconds, first_step_cached_seconds,
TECHNIQUE_describe_ms, live_hog_frames_per_second and live_overhead_ms (per frame, beyond the
techniques that ran); with a `belief_` before it, of that statistic. docs/performance.md says what
each ratio is.
"""

import _one_thread  # noqa: F401  (first: NumPy reads it)

# isort: split
import inspect
import json
import statistics
import time
from collections.abc import Callable
from functools import partial
from itertools import cycle
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from _bench_material import BYTES_PER_PLACE, QUICK, Corrections, Material, Sizes, gather, stream
from _bench_waits import measure_images, measure_start
from _cli import Parser, destination, run
from amusic_baselines.scores import standardised

from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.utils.storage import write_whole

Settings = dict[str, Any]
CARRY: Settings = {"carry": True}
BELIEF: Settings = {"statistic": "belief", "carry": None, "discount": None}

Measured = tuple[float, str]  # a ratio, and a sentence on both sides
Measure = Callable[[Material], Measured]


class Side(NamedTuple):
    """One of two things to compare."""

    name: str  # what is timed, for the table
    work: Callable[[], object]  # the timed call
    units: float  # units of work (steps, corrections, bytes) of one call
    # brings the state back before every call; not timed
    prepare: Callable[[], object] = lambda: None


def compare(
    ours: Side, theirs: Side, rounds: int, unit: str = "step", *, time_of_ours: bool = False
) -> Measured:
    """Units of our side in the time of one of theirs; or its time by theirs.

    The sides take turns, A B A B …, so that a slower spell of the machine meets both; the median
    over the rounds forgives what else it does in a few of them. The first round is not counted.
    """
    samples: tuple[list[float], list[float]] = ([], [])
    for _ in range(rounds + 1):
        for side, kept in zip((ours, theirs), samples, strict=True):
            side.prepare()
            start = time.perf_counter()
            side.work()
            kept.append((time.perf_counter() - start) / side.units)
    mine, other = (statistics.median(kept[1:]) for kept in samples)
    both = f"{ours.name} {readable(mine, unit)}, {theirs.name} {readable(other, unit)}"
    sentence = both if unit == "byte" else f"{both} per {unit}"
    return mine / other if time_of_ours else other / mine, sentence


def readable(seconds: float, unit: str) -> str:
    """A duration with three digits and its unit; of a byte, how many there are in a second."""
    if unit == "byte":
        return f"{1e-9 / seconds:.3g} GB/s"
    for factor, name in ((1.0, "s"), (1e3, "ms"), (1e6, "µs")):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {name}"
    return f"{seconds * 1e9:.3g} ns"


def measure_sic(material: Material) -> Measured:
    """One SIC correction at the last frame against the K×F gather in NumPy."""
    sizes, ours = material.sizes, Corrections(material)
    frame, rows = sizes.frames - 1, material.bank.scores[0]
    z = standardised(rows.astype(np.float64))
    top = np.argsort(-rows, axis=1, kind="stable")[:, : sizes.candidates]

    def gather_all() -> list[tuple[int, float]]:
        found = []
        for i in range(sizes.routes):
            values = gather(z[i:], frame, top[i + frame], sizes.history)
            best = int(np.argmax(values))
            found.append((int(top[i + frame][best]), float(values[best])))
        return found

    ours.forward()  # nothing wrong is timed
    np.testing.assert_allclose(np.stack([ours.places, ours.statistics], 1), gather_all(), 1e-9)
    return compare(
        Side("compiled", ours.forward, sizes.routes * sizes.steps, ours.rewind),
        Side("NumPy gather", gather_all, sizes.routes),
        sizes.rounds,
        "correction",
    )


def measure_limit(material: Material) -> Measured:
    """The accumulator's row add against a plain stream over as many bytes."""
    sizes, ours = material.sizes, Corrections(material)
    windows = np.zeros((sizes.routes, sizes.places))
    rows = material.bank.scores[0]

    def stream_all() -> None:
        for frame in ours.frames:
            stream(rows[frame : frame + sizes.routes], windows)

    size = sizes.routes * sizes.places * len(ours.frames) * BYTES_PER_PLACE
    return compare(
        Side("SIC's row add", ours.add_rows, size, ours.rewind),
        Side("plain stream", stream_all, size),
        sizes.rounds,
        "byte",
    )


def env_side(
    material: Material, name: str, *, single: bool = False, half: bool = False, behind: int = 0,
    **settings: Any,
) -> Side:  # fmt: skip
    """Steps of the vector env, or the single one; all techniques run, or a random half of them.

    A route is played, so that its rows are ready, begun again and brought to where timing starts.
    With ``behind`` 1 that is sooner by the timed frames: of two sides on the same frames, the
    second would find their rows in the cache.
    """
    sizes, arguments = material.sizes, material.arguments(**settings)
    everything = np.ones((sizes.routes, sizes.techniques), np.int8)
    env: Any
    start: Any
    if single:
        env, routes, start = TechniqueSelectionEnv(**arguments), 1, 0
        actions = cycle(everything[:1])
    else:
        routes, start = sizes.routes, np.arange(sizes.routes)
        env = TechniqueSelectionVectorEnv(routes, **arguments)
        drawn = np.random.default_rng(1).integers(0, 2, (97, *everything.shape), np.int8)
        actions = cycle(drawn if half else everything[None])

    def advance(steps: int = sizes.steps) -> None:
        for _ in range(steps):
            env.step(next(actions))

    for frames in (sizes.frames, sizes.frames - (1 + behind) * (sizes.rounds + 1) * sizes.steps):
        env.reset(seed=0, options={"start": start})
        advance(frames)
    return Side(name, advance, sizes.steps * routes)


def measure_vector_env(material: Material) -> Measured:
    """The vector env against Gymnasium's native CartPole."""
    sizes = material.sizes
    cartpole = gym.make_vec(
        "CartPole-v1", num_envs=sizes.routes, vectorization_mode="vector_entry_point"
    )
    cartpole.reset(seed=0)
    pushes = cycle(np.random.default_rng(0).integers(0, 2, (97, sizes.routes)))

    def balance() -> None:
        for _ in range(sizes.steps):
            cartpole.step(next(pushes))

    theirs = Side("CartPole vector env", balance, sizes.steps * sizes.routes)
    return compare(env_side(material, "vector env"), theirs, sizes.rounds)


def measure_single_env(material: Material) -> Measured:
    """The single env, without wrappers, against CartPole."""
    sizes = material.sizes
    cartpole = gym.make("CartPole-v1").unwrapped
    cartpole.reset(seed=0)
    pushes = cycle(np.random.default_rng(0).integers(0, 2, 997).tolist())

    def balance() -> None:
        for _ in range(sizes.steps):
            if cartpole.step(next(pushes))[2]:
                cartpole.reset()

    theirs = Side("CartPole", balance, sizes.steps)
    return compare(env_side(material, "single env", single=True), theirs, sizes.rounds)


def pair(ours: str, settings: Settings, theirs: str, others: Settings, both: Settings) -> Measure:
    """Measures the time of a step of one environment with two settings.

    The correlation of a row with the one before it is kept with the bank, as mean, deviation and
    candidates are: none of them is timed.
    """

    def measure(material: Material) -> Measured:
        first = env_side(material, ours, behind=1, **settings, **both)
        second = env_side(material, theirs, **others, **both)
        return compare(first, second, material.sizes.rounds, time_of_ours=True)

    return measure


def measure_ppo(material: Material) -> Measured:
    """PPO's wall time on the env against the same PPO on an env that returns constants."""
    import torch
    from amusic_agents.adapter import SB3VecEnv
    from stable_baselines3 import PPO

    class Constant(SB3VecEnv):
        """Returns what its environment once returned."""

        def step_wait(self) -> Any:
            return constants

    torch.set_num_threads(1)
    sizes, sides = material.sizes, []
    given = material.arguments(random_start=True, autoreset_mode="SameStep")
    for kind, name in ((SB3VecEnv, "PPO on the env"), (Constant, "PPO on constants")):
        env = kind(TechniqueSelectionVectorEnv(sizes.routes, **given))
        observation = env.reset()
        nothing = np.zeros(sizes.routes, np.float32)
        constants: Any = observation, nothing, nothing > 0, [{} for _ in nothing]
        model = PPO(
            *("MlpPolicy", env), n_steps=sizes.ppo_steps, batch_size=sizes.ppo_batch, seed=0,
            device="cpu",
        )  # fmt: skip
        steps = sizes.routes * sizes.ppo_steps
        learn = partial(model.learn, steps, reset_num_timesteps=False)
        sides.append(Side(name, learn, steps))
    return compare(sides[0], sides[1], sizes.ppo_rounds, time_of_ours=True)


MEASUREMENTS: dict[str, Measure] = {
    "sic_vs_numpy": measure_sic,
    "sic_share_of_limit": measure_limit,
    "vector_env_vs_cartpole_vector": measure_vector_env,
    "single_env_vs_cartpole": measure_single_env,
    "half_step_vs_whole": pair("a half", {"half": True}, "all techniques", {}, {}),
    "carry_step_vs_without": pair("with carry", CARRY, "without", {}, {}),
    "discount_step_vs_without": pair("with discount", {"discount": True}, "without", {}, CARRY),
    "belief_step_vs_evidence": pair("belief", BELIEF, "evidence", {}, {"single": True}),
    "belief_two_threads_vs_one": pair("one thread", {}, "two threads", {"threads": 2}, BELIEF),
    "ppo_vs_constant_env": measure_ppo,
}


def main() -> None:
    """Measure, print and write."""
    parser = Parser(prog="bench.py", description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("--out", type=destination, required=True, metavar="FILE", help="JSON to write")
    add("--quick", action="store_true", help="small sizes: shows that it runs, not how fast it is")
    add("--only", nargs="+", metavar="KEY", choices=MEASUREMENTS, help="only these ratios")
    args = parser.parse_args()
    if args.out.is_dir():
        raise ValueError(f"--out {args.out} is a folder; name a file")
    sizes = QUICK if args.quick else Sizes()
    print(
        f"{sizes.techniques} techniques, {sizes.places} places, K = {sizes.candidates},"
        f" F = {sizes.history}, frame {sizes.frames - 1}, {sizes.routes} routes, one thread;"
        f"\nmedians of {sizes.rounds} rounds in which both sides take turns"
        f" ({sizes.ppo_rounds} for PPO)\n\nThe gather in NumPy that SIC is compared with:\n"
    )
    print(inspect.getsource(gather))
    measures: dict[str, float] = {}

    def report(name: str, value: float, sentence: str) -> None:
        measures[name] = value
        print(f"{name:30} {value:9.3g}   {sentence}", flush=True)

    material = Material(sizes)
    for name in args.only or MEASUREMENTS:
        report(name, *MEASUREMENTS[name](material))
    if not args.only:
        measure_start(sizes, report)
        measure_images(sizes, report)
    write_whole(args.out, (json.dumps(measures, indent=1) + "\n").encode())


if __name__ == "__main__":
    run(main)
