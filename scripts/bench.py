"""Measure the speed, as ratios of two sides in one run; print a table and write a JSON object.

    python scripts/bench.py --out FILE.json

Every timed path is checked first against NumPy code of another kind (_bench_reference.py), that of
the default statistic against the true places. The sides take turns, after one warm-up, on one
thread unless it says two; each figure is a median. All is with the statistic `evidence`, γ = 1,
nothing carried on and no discount, unless it says `default`: the figures that begin so are with
what the environment takes by itself.

| ratio | of what | better |
|---|---|---|
| sic_vs_numpy | one SIC correction: time of the gather in NumPy / ours | more |
| sic_vs_numpy_loop | … of a NumPy loop over the candidates / ours | more |
| vector_env_vs_cartpole_vector | steps/s of the vector env / Gymnasium's CartPole one | more |
| single_env_vs_cartpole | steps/s of the unwrapped single env / unwrapped CartPole | more |
| half_step_vs_whole | time of the vector step: a random half of the techniques / all | less |
| ppo_vs_constant_env | wall time of PPO on the env / on one that returns constants | near 1 |
| ppo_large_vs_constant_env | as above, 256 routes and batches of 8192 | near 1 |
| sic_share_of_limit | bytes/s of the accumulator's row add / of a plain stream | near 1 |
| step_share_of_limit | time of plain streams over a step's rows / of the vector step | near 1 |
| cohog_match_vs_numpy | CoHOG's matching with one place: time of a NumPy loop / ours | more |
| cohog_match_share_of_limit | time of the bare matrix product of the cells / ours | near 1 |
| default_vector_env_vs_cartpole_vector | as above, default statistic | more |
| default_single_env_vs_cartpole | as above, default statistic | more |
| carry_step_vs_without | time of the vector step: places carried on / not, no discount | near 1 |
| discount_step_vs_without | … with the discount / without, places carried on | near 1 |
| default_step_vs_evidence | time of the single env's step: default / neither of both | near 1 |
| belief_step_vs_evidence | … statistic `belief` / neither of both | less |
| belief_two_threads_vs_one | steps/s of the vector env, `belief`, on two threads / on one | more |

And what a robot waits for, which is this machine's: default_step_ms, belief_step_ms,
TECHNIQUE_describe_ms, live_overhead_ms and belief_live_overhead_ms (per frame, beyond the
techniques that ran) and live_hog_frames_per_second; import_seconds and first_step_…_seconds, cold
and with compiled code. These are with the defaults.

How time grows with the map: sic_us_at_R for R places, growth_exponent (1 is linear) between the
largest two; route_bytes_per_place. With --big, a memory-mapped bank of 3.2 GB is written to a
temporary folder and driven through with 2 GB of memory: big_anonymous_mb, big_run_us,
big_share_of_read (time to copy the row / to take it into the sums and correct).

With --layouts, ways to keep the sums that were tried and rejected: rejected_… (time of each / of
what took its place) and waiting_at_R (time of rows that wait / of rows added at once).

Beside the JSON object stand a roofline, what each part does per second against what memory and
arithmetic of this machine allow, and the growth with the map.
"""

from __future__ import annotations

import argparse
import inspect
import json
from collections.abc import Callable
from functools import partial
from itertools import cycle
from typing import Any, NamedTuple

from _timing import Medians, Side, interleave, one_thread, readable

one_thread()

from _cli import Parser, destination, run  # noqa: E402  (after the line above, which NumPy reads)

# isort: split
import _bench_reference as reference  # noqa: E402
import gymnasium as gym  # noqa: E402
import numpy as np  # noqa: E402
from _bench_figure import draw_growth, draw_roofline, points_of  # noqa: E402
from _bench_growth import (  # noqa: E402
    BIG_SHAPE,
    QUICK_SHAPE,
    QUICK_SIZES,
    SIZES,
    measure_big,
    measure_growth,
    measure_memory,
)
from _bench_images import QUICK_IMAGES, ImageSizes, measure_images  # noqa: E402
from _bench_kernels import BYTES_PER_PLACE, push_routes, stream  # noqa: E402
from _bench_layouts import measure_layouts, measure_waiting  # noqa: E402
from _bench_material import (  # noqa: E402
    DEFAULT,
    PLAIN,
    QUICK,
    Corrections,
    Material,
    Sizes,
    same,
)
from _bench_start import measure_start  # noqa: E402

from amusic_gym.envs.env import TechniqueSelectionEnv  # noqa: E402
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv  # noqa: E402
from amusic_gym.estimation.settings import SICSettings  # noqa: E402
from amusic_gym.utils.storage import write_whole  # noqa: E402

BELIEF: dict[str, Any] = {"statistic": "belief", "carry": None, "discount": None}

Report = Callable[[str, float, str], None]
"""Takes a key, its value, and a sentence on it."""


class Measured(NamedTuple):
    """A line of the table."""

    ratio: float
    medians: Medians
    unit: str
    ours: str
    theirs: str


def measure_sic(material: Material) -> Measured:
    """One SIC correction at the last frame against the K×F gather in NumPy."""
    sizes, ours = material.sizes, Corrections(material)
    frame, z, top = sizes.frames - 1, material.z[0], material.top[0]

    def gather_all() -> list[tuple[int, float]]:
        found = []
        for i in range(sizes.routes):
            values = reference.gather(z[i:], frame, top[i + frame], sizes.history)
            best = int(np.argmax(values))
            found.append((int(top[i + frame][best]), float(values[best])))
        return found

    ours.forward()
    for i, (place, statistic) in enumerate(gather_all()):
        same(f"place of route {i}", ours.places[i], place, 0.0)
        same(f"statistic of route {i}", ours.statistics[i], statistic, 1e-9)
    medians = interleave(
        Side("compiled", ours.forward, sizes.routes * sizes.steps, ours.rewind),
        Side("NumPy", gather_all, sizes.routes),
        sizes.rounds,
    )
    return Measured(medians.faster, medians, "correction", "compiled", "NumPy gather")


def measure_sic_loop(material: Material) -> Measured:
    """One SIC correction at the last frame against a NumPy loop over the candidates."""
    sizes, ours = material.sizes, Corrections(material)
    frame, z, top = sizes.frames - 1, material.z[0], material.top[0]

    def loop() -> list[float]:
        return reference.gather_one_by_one(z, frame, top[frame], sizes.history)

    ours.forward()
    same("statistic of route 0", ours.statistics[0], max(loop()), 1e-9)
    medians = interleave(
        Side("compiled", ours.forward, sizes.routes * sizes.steps, ours.rewind),
        Side("NumPy", loop, 1),
        sizes.rounds,
    )
    return Measured(medians.faster, medians, "correction", "compiled", "NumPy loop")


def measure_limit(material: Material) -> Measured:
    """The accumulator's row add against a plain stream over as many bytes."""
    sizes, ours = material.sizes, Corrections(material)
    frames = ours.frames
    windows = np.zeros((sizes.routes, sizes.places))
    rows = material.bank.scores[0]

    def push_all() -> None:
        for frame in frames:
            push_routes(ours.sums, ours.marks, ours.runs, ours.histories[0], frame, ours.history)

    def stream_all() -> None:
        for frame in frames:
            stream(rows[frame : frame + sizes.routes], windows)

    _check_sums(material, ours, push_all)
    stream_all()
    summed = sum(rows[f : f + sizes.routes].astype(np.float64) for f in frames)
    if not np.allclose(windows, summed, rtol=1e-12, atol=1e-12):
        raise RuntimeError("the stream's sums are wrong: nothing wrong is timed")
    places = sizes.routes * sizes.places * len(frames)
    medians = interleave(
        Side("row add", push_all, places * BYTES_PER_PLACE, ours.rewind),
        Side("stream", stream_all, places * BYTES_PER_PLACE),
        sizes.rounds,
    )
    return Measured(medians.faster, medians, "byte", "SIC's row add", "plain stream")


def _check_sums(material: Material, ours: Corrections, push_all: Callable[[], None]) -> None:
    """Compare the sums of route 0 after the timed frames with those of its diagonals."""
    last, z = material.sizes.frames - 1, material.z[0]
    ours.histories[0][:, ours.frames.start :] = 1
    push_all()
    window = ours.sums[0, ours.marks[0]["origin"] - last :]
    for place in range(0, material.sizes.places, 37):
        ages = np.arange(min(material.sizes.history, last, place) + 1)
        want = float(z[last - ages, place - ages].sum())
        same(f"sum of place {place}", float(window[place]), want, 1e-8)


def _stepper(env: Any, action: Any, steps: int) -> Callable[[], None]:
    def advance() -> None:
        for _ in range(steps):
            env.step(action)

    return advance


def _play_checked(
    env: Any, material: Material, action: Any, options: dict[str, Any], behind: int = 0
) -> None:
    """Play a whole route and compare; then begin again and go on to where timing starts.

    ``behind`` times the timed frames sooner: of two sides on the same frames, the second would
    find their rows in the cache.
    """
    exact = {name: getattr(env.task.settings, name) for name in PLAIN} == PLAIN
    env.reset(seed=0, options=options)
    for frame in range(material.sizes.frames):
        _, rewards, _, _, infos = env.step(action)
        if frame in material.checked_frames():
            if exact:
                material.check_frame(frame, rewards, infos)
            else:
                material.check_places(frame, infos)
    env.reset(seed=0, options=options)
    _stepper(env, action, material.sizes.frames - (1 + behind) * material.sizes.timed)()


def measure_vector_env(material: Material, **other: Any) -> Measured:
    """The vector env, all techniques on all routes, against Gymnasium's native CartPole."""
    sizes = material.sizes
    env = TechniqueSelectionVectorEnv(sizes.routes, **material.env_arguments(**other))
    _play_checked(env, material, material.everything, {"start": material.starts})
    cartpole = gym.make_vec(
        "CartPole-v1", num_envs=sizes.routes, vectorization_mode="vector_entry_point"
    )
    cartpole.reset(seed=0)
    pushes = cycle(np.random.default_rng(0).integers(0, 2, (97, sizes.routes)))

    def balance() -> None:
        for _ in range(sizes.steps):
            cartpole.step(next(pushes))

    units = sizes.steps * sizes.routes
    medians = interleave(
        Side("ours", _stepper(env, material.everything, sizes.steps), units),
        Side("CartPole", balance, units),
        sizes.rounds,
    )
    return Measured(medians.faster, medians, "step", "vector env", "CartPole vector env")


def measure_half(material: Material) -> Measured:
    """The vector env's step with a random half of the techniques against one with all."""
    sizes, ran = material.sizes, []
    half, whole = (
        TechniqueSelectionVectorEnv(sizes.routes, **material.env_arguments()) for _ in range(2)
    )
    _play_checked(whole, material, material.everything, {"start": material.starts})
    half.reset(seed=0, options={"start": material.starts})
    for frame, action in enumerate(material.halves):
        infos = half.step(action)[-1]
        ran.append(infos["ran"])
        if frame in material.checked_frames():
            material.check_statistics(frame, np.array(ran), infos)
    half.reset(seed=0, options={"start": material.starts})
    actions = iter(material.halves)
    for _ in range(sizes.frames - sizes.timed):
        half.step(next(actions))

    def advance() -> None:
        for _ in range(sizes.steps):
            half.step(next(actions))

    units = sizes.steps * sizes.routes
    medians = interleave(
        Side("half", advance, units),
        Side("whole", _stepper(whole, material.everything, sizes.steps), units),
        sizes.rounds,
    )
    return Measured(1.0 / medians.faster, medians, "step", "a half", "all techniques")


def measure_step(material: Material, **other: Any) -> Measured:
    """The single env's step with other settings against one with `PLAIN`."""
    sizes, action, steppers = material.sizes, material.everything[0], []
    for behind, arguments in enumerate((material.env_arguments(**other), material.env_arguments())):
        env = TechniqueSelectionEnv(**arguments)
        _play_checked(env, material, action, {"start": 0}, behind)
        steppers.append(_stepper(env, action, sizes.steps))
    theirs, plain = (Side("settings", step, sizes.steps) for step in steppers)
    medians = interleave(theirs, plain, sizes.rounds)
    return Measured(1.0 / medians.faster, medians, "step", "these settings", "plain evidence")


def measure_part(material: Material, name: str, **other: Any) -> Measured:
    """The vector env's step with a part of SIC on against the step with it off.

    The correlation of a row with the one before it is kept with the bank, as mean, deviation and
    candidates are: none of them is timed.
    """
    sizes, steppers = material.sizes, []
    for on in (True, False):
        arguments = material.env_arguments(**other, **{name: on})
        env = TechniqueSelectionVectorEnv(sizes.routes, **arguments)
        _play_checked(env, material, material.everything, {"start": material.starts}, int(on))
        steppers.append(_stepper(env, material.everything, sizes.steps))
    units = sizes.steps * sizes.routes
    with_it, without = (Side(name, step, units) for step in steppers)
    medians = interleave(with_it, without, sizes.rounds)
    return Measured(1.0 / medians.faster, medians, "step", f"with {name}", "without")


def measure_threads(material: Material) -> Measured:
    """The vector env's step with the statistic `belief`, on two threads against one."""
    sizes, steppers = material.sizes, []
    for threads in (2, 1):
        arguments = material.env_arguments(**BELIEF)
        env = TechniqueSelectionVectorEnv(sizes.routes, threads=threads, **arguments)
        _play_checked(env, material, material.everything, {"start": material.starts})
        steppers.append(_stepper(env, material.everything, sizes.steps))
    units = sizes.steps * sizes.routes
    two, one = (Side("threads", step, units) for step in steppers)
    medians = interleave(two, one, sizes.rounds)
    return Measured(medians.faster, medians, "step", "two threads", "one thread")


def measure_step_limit(material: Material) -> Measured:
    """The vector env's step, all techniques, against plain streams over as many rows."""
    sizes = material.sizes
    env = TechniqueSelectionVectorEnv(sizes.routes, **material.env_arguments())
    _play_checked(env, material, material.everything, {"start": material.starts})
    windows = np.zeros((sizes.techniques, sizes.routes, sizes.places))

    def stream_all() -> None:
        for step in range(sizes.steps):
            for t, rows in enumerate(material.bank.scores):
                stream(rows[step : step + sizes.routes], windows[t])

    units = sizes.steps * sizes.routes
    medians = interleave(
        Side("step", _stepper(env, material.everything, sizes.steps), units),
        Side("streams", stream_all, units),
        sizes.rounds,
    )
    return Measured(medians.faster, medians, "step", "vector env", "plain streams")


def measure_single_env(material: Material, **other: Any) -> Measured:
    """The single env, all techniques, against CartPole, both without wrappers."""
    sizes, action = material.sizes, material.everything[0]
    env = TechniqueSelectionEnv(**material.env_arguments(**other))
    _play_checked(env, material, action, {"start": 0})
    cartpole = gym.make("CartPole-v1").unwrapped
    cartpole.reset(seed=0)
    pushes = cycle(np.random.default_rng(0).integers(0, 2, 997).tolist())

    def balance() -> None:
        for _ in range(sizes.steps):
            if cartpole.step(next(pushes))[2]:
                cartpole.reset()

    medians = interleave(
        Side("ours", _stepper(env, action, sizes.steps), sizes.steps),
        Side("CartPole", balance, sizes.steps),
        sizes.rounds,
    )
    return Measured(medians.faster, medians, "step", "single env", "CartPole")


def measure_ppo(material: Material) -> Measured:
    """PPO's wall time on the env against the same PPO on an env that returns constants."""
    import torch
    from _bench_constant import ConstantVecEnv
    from amusic_agents.adapter import SB3VecEnv
    from stable_baselines3 import PPO

    torch.set_num_threads(1)
    sizes = material.sizes
    env = SB3VecEnv(
        TechniqueSelectionVectorEnv(
            sizes.routes, **material.env_arguments(), random_start=True, autoreset_mode="SameStep"
        )
    )
    env.set_options([{"start": int(start)} for start in material.starts])
    env.reset()
    for frame in range(sizes.frames):
        rewards = env.step(material.everything)[1]
        if frame in material.checked_frames():
            material.check_frame(frame, rewards, None)
    constant = ConstantVecEnv(sizes.routes, env.observation_space, env.action_space)
    steps = sizes.routes * sizes.ppo_steps
    sides = []
    for routes in (env, constant):
        model = PPO(
            "MlpPolicy",
            routes,
            n_steps=sizes.ppo_steps,
            batch_size=sizes.ppo_batch,
            seed=0,
            device="cpu",
        )
        sides.append(Side(type(routes).__name__, _learner(model, steps), steps))
    medians = interleave(sides[0], sides[1], sizes.ppo_rounds)
    ratio = 1.0 / medians.faster
    return Measured(ratio, medians, "step", "PPO on the env", "PPO on constants")


def _learner(model: Any, steps: int) -> Callable[[], None]:
    def learn() -> None:
        model.learn(steps, reset_num_timesteps=False)

    return learn


def measure_large_ppo(material: Material) -> Measured:
    """As measure_ppo, with more routes and larger batches."""
    sizes = material.sizes
    large = sizes._replace(routes=4 * sizes.routes, ppo_batch=16 * sizes.ppo_batch)
    return measure_ppo(Material(large))


MEASUREMENTS: dict[str, Callable[[Material], Measured]] = {
    "sic_vs_numpy": measure_sic,
    "sic_vs_numpy_loop": measure_sic_loop,
    "vector_env_vs_cartpole_vector": measure_vector_env,
    "single_env_vs_cartpole": measure_single_env,
    "half_step_vs_whole": measure_half,
    "ppo_vs_constant_env": measure_ppo,
    "ppo_large_vs_constant_env": measure_large_ppo,
    "sic_share_of_limit": measure_limit,
    "step_share_of_limit": measure_step_limit,
    "default_vector_env_vs_cartpole_vector": partial(measure_vector_env, **DEFAULT),
    "default_single_env_vs_cartpole": partial(measure_single_env, **DEFAULT),
    "carry_step_vs_without": partial(measure_part, name="carry"),
    "discount_step_vs_without": partial(measure_part, name="discount", carry=True),
    "default_step_vs_evidence": partial(measure_step, **DEFAULT),
    "belief_step_vs_evidence": partial(measure_step, **BELIEF),
    "belief_two_threads_vs_one": measure_threads,
}


def _line(name: str, measured: Measured) -> str:
    ours, theirs = (readable(seconds) for seconds in measured.medians)
    what = f"{measured.ours} {ours}, {measured.theirs} {theirs} per {measured.unit}"
    if measured.unit == "byte":
        fast, most = (1e-9 / seconds for seconds in measured.medians)
        what = f"{measured.ours} {fast:.3g} GB/s, {measured.theirs} {most:.3g} GB/s"
    return f"{name:30} {measured.ratio:9.3g}   {what}"


def _parser() -> argparse.ArgumentParser:
    first = (__doc__ or "").splitlines()[0]
    parser = Parser(prog="bench.py", description=first)
    parser.add_argument(
        "--out", type=destination, required=True, metavar="FILE", help="JSON to write"
    )
    parser.add_argument(
        "--quick", action="store_true", help="small sizes: shows that it runs, not how fast it is"
    )
    parser.add_argument(
        "--big", action="store_true", help="also a bank of 3.2 GB, written to a temporary folder"
    )
    parser.add_argument(
        "--layouts", action="store_true", help="also layouts of the sums that were rejected"
    )
    parser.add_argument(
        "--only", nargs="+", metavar="KEY", choices=MEASUREMENTS, help="only these ratios"
    )
    return parser


def main() -> None:
    """Measure, print and write."""
    args = _parser().parse_args()
    if args.out.is_dir():
        raise ValueError(f"--out {args.out} is a folder; name a file")
    sizes = QUICK if args.quick else Sizes()
    print(
        f"{sizes.techniques} techniques, {sizes.places} places, K = {sizes.candidates},"
        f" F = {sizes.history}, frame {sizes.frames - 1}, {sizes.routes} routes, one thread;"
        f"\nmedians of {sizes.rounds} rounds in which both sides take turns"
        f" ({sizes.ppo_rounds} for PPO)\n\nThe gather in NumPy that SIC is compared with:\n"
    )
    print(inspect.getsource(reference.gather))
    material = Material(sizes)
    measures, seconds = {}, {}
    for name in args.only or MEASUREMENTS:
        measured = MEASUREMENTS[name](material)
        measures[name], seconds[name] = measured.ratio, measured.medians
        print(_line(name, measured), flush=True)

    def report(name: str, value: float, sentence: str) -> None:
        measures[name] = value
        print(f"{name:30} {value:9.3g}   {sentence}", flush=True)

    if not args.only:
        _measure_rest(args, material, seconds, report)
    write_whole(args.out, (json.dumps(measures, indent=1) + "\n").encode())


def _measure_rest(
    args: argparse.Namespace, material: Material, seconds: dict[str, Medians], report: Report
) -> None:
    """What is not a ratio of two sides, and the figure."""
    for name in ("default", "belief"):
        step = seconds[f"{name}_step_vs_evidence"].ours
        report(f"{name}_step_ms", 1e3 * step, f"ms per step of the single env, {name}")
    places = QUICK_SIZES if args.quick else SIZES
    growth = measure_growth(places, report)
    measure_memory(material, report)
    statistics = {"": SICSettings.statistic, "belief_": "belief"}
    measure_start(statistics, 1 if args.quick else 5, report)
    if args.layouts:
        measure_layouts(material, report)
        measure_waiting(QUICK_SIZES if args.quick else SIZES[:-1], report)
    if args.big:
        measure_big(QUICK_SHAPE if args.quick else BIG_SHAPE, report)
    product = measure_images(QUICK_IMAGES if args.quick else ImageSizes(), report)
    figure = args.out.with_suffix(".png")
    draw_roofline(points_of(material.sizes, seconds), product, figure)
    print(f"roofline: {figure}")
    figure = figure.with_name(f"{figure.stem}-growth.png")
    draw_growth(places, growth, figure)
    print(f"growth: {figure}")


if __name__ == "__main__":
    run(main)
