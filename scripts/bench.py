"""Measure the speed, as ratios of two sides in one run; print a table and write a JSON object.

    python scripts/bench.py --out FILE.json

The sides take turns, after one warm-up, on one thread unless it says two; each figure is a median.
SIC is compared with NumPy's gather before it is timed, the environments with the true places. All
with the statistic `evidence`, γ = 1, nothing carried on and no discount, unless it says so. And
what a user waits for, with the defaults, which is this machine's: import_seconds,
first_step_cold_seconds, first_step_cached_seconds, TECHNIQUE_describe_ms,
live_hog_frames_per_second and live_overhead_ms (per frame, beyond the techniques that ran); with a
`belief_` before it, of that statistic. docs/performance.md says what each ratio is.
"""

import inspect
import json
from collections.abc import Callable
from functools import partial
from itertools import cycle
from typing import Any, NamedTuple

from _timing import Side, interleave, one_thread, readable

one_thread()

from _cli import Parser, destination, run  # noqa: E402  (after the line above, which NumPy reads)

# isort: split
import gymnasium as gym  # noqa: E402
import numpy as np  # noqa: E402
from _bench_material import (  # noqa: E402
    BYTES_PER_PLACE,
    QUICK,
    Corrections,
    Material,
    Sizes,
    gather,
    same,
    standardised,
    stream,
)
from _bench_waits import measure_images, measure_start  # noqa: E402

from amusic_gym.envs.env import TechniqueSelectionEnv  # noqa: E402
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv  # noqa: E402
from amusic_gym.utils.storage import write_whole  # noqa: E402

CARRY: dict[str, Any] = {"carry": True}
DISCOUNT: dict[str, Any] = {"carry": True, "discount": True}
BELIEF: dict[str, Any] = {"statistic": "belief", "carry": None, "discount": None}
THREADS: dict[str, Any] = {**BELIEF, "threads": 2}


class Measured(NamedTuple):
    """A line of the table."""

    ratio: float
    sides: tuple[Side, Side]
    seconds: tuple[float, float]  # per unit
    unit: str


def compare(
    ours: Side, theirs: Side, rounds: int, unit: str = "step", *, time: bool = False
) -> Measured:
    """Units of our side in the time of one of theirs; with ``time``, its time by theirs."""
    mine, other = interleave(ours, theirs, rounds)
    return Measured(mine / other if time else other / mine, (ours, theirs), (mine, other), unit)


def measure_sic(material: Material) -> Measured:
    """One SIC correction at the last frame against the K×F gather in NumPy."""
    sizes, ours = material.sizes, Corrections(material)
    frame, rows = sizes.frames - 1, material.bank.scores[0]
    z = standardised(rows)
    top = np.argsort(-rows, axis=1, kind="stable")[:, : sizes.candidates]

    def gather_all() -> list[tuple[int, float]]:
        found = []
        for i in range(sizes.routes):
            values = gather(z[i:], frame, top[i + frame], sizes.history)
            best = int(np.argmax(values))
            found.append((int(top[i + frame][best]), float(values[best])))
        return found

    ours.forward()
    for i, (place, statistic) in enumerate(gather_all()):
        same(f"place of route {i}", ours.places[i], place, 0.0)
        same(f"statistic of route {i}", ours.statistics[i], statistic, 1e-9)
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


def vector_side(
    material: Material, name: str, *, behind: int = 0, half: bool = False, **other: Any
) -> Side:
    """Steps of the vector env, all techniques or a random half of them."""
    sizes, everything = material.sizes, material.everything
    rng = np.random.default_rng(1)
    actions = rng.integers(0, 2, (97, *everything.shape), np.int8) if half else [everything]
    env = TechniqueSelectionVectorEnv(sizes.routes, **material.env_arguments(**other))
    step = material.stepper(env, cycle(actions), material.starts, behind)
    return Side(name, step, sizes.steps * sizes.routes)


def single_side(material: Material, name: str, *, behind: int = 0, **other: Any) -> Side:
    """Steps of the single env, all techniques, without wrappers."""
    env = TechniqueSelectionEnv(**material.env_arguments(**other))
    step = material.stepper(env, cycle(material.everything[:1]), 0, behind)
    return Side(name, step, material.sizes.steps)


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
    return compare(vector_side(material, "vector env"), theirs, sizes.rounds)


def measure_single_env(material: Material) -> Measured:
    """The single env against CartPole."""
    sizes = material.sizes
    cartpole = gym.make("CartPole-v1").unwrapped
    cartpole.reset(seed=0)
    pushes = cycle(np.random.default_rng(0).integers(0, 2, 997).tolist())

    def balance() -> None:
        for _ in range(sizes.steps):
            if cartpole.step(next(pushes))[2]:
                cartpole.reset()

    theirs = Side("CartPole", balance, sizes.steps)
    return compare(single_side(material, "single env"), theirs, sizes.rounds)


def measure_pair(material: Material, pair: tuple[Any, ...]) -> Measured:
    """Time of a step of one environment with two settings, see `PAIRS`.

    The correlation of a row with the one before it is kept with the bank, as mean, deviation and
    candidates are: none of them is timed.
    """
    side, ours, arguments, theirs, others = pair
    first = side(material, ours, behind=1, **arguments)
    return compare(first, side(material, theirs, **others), material.sizes.rounds, time=True)


PAIRS = {
    "half_step_vs_whole": (vector_side, "a half", {"half": True}, "all techniques", {}),
    "carry_step_vs_without": (vector_side, "with carry", CARRY, "without", {}),
    "discount_step_vs_without": (vector_side, "with discount", DISCOUNT, "without", CARRY),
    "belief_step_vs_evidence": (single_side, "belief", BELIEF, "evidence", {}),
    "belief_two_threads_vs_one": (vector_side, "one thread", BELIEF, "two threads", THREADS),
}
"""Key → an environment, and the name and arguments of either side."""


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
    given = {**material.env_arguments(), "random_start": True, "autoreset_mode": "SameStep"}
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
    return compare(sides[0], sides[1], sizes.ppo_rounds, time=True)


MEASUREMENTS: dict[str, Callable[[Material], Measured]] = {
    "sic_vs_numpy": measure_sic,
    "sic_share_of_limit": measure_limit,
    "vector_env_vs_cartpole_vector": measure_vector_env,
    "single_env_vs_cartpole": measure_single_env,
    **{key: partial(measure_pair, pair=pair) for key, pair in PAIRS.items()},
    "ppo_vs_constant_env": measure_ppo,
}


def _sentence(measured: Measured) -> str:
    """Both sides' times per unit, or their bytes per second."""
    names = (side.name for side in measured.sides)
    if measured.unit == "byte":
        shown = [f"{1e-9 / seconds:.3g} GB/s" for seconds in measured.seconds]
    else:
        shown = [readable(seconds) for seconds in measured.seconds]
    both = ", ".join(f"{name} {time}" for name, time in zip(names, shown, strict=True))
    return both if measured.unit == "byte" else f"{both} per {measured.unit}"


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
        measured = MEASUREMENTS[name](material)
        report(name, measured.ratio, _sentence(measured))
    if not args.only:
        measure_start(sizes, report)
        measure_images(sizes, report)
    write_whole(args.out, (json.dumps(measures, indent=1) + "\n").encode())


if __name__ == "__main__":
    run(main)
