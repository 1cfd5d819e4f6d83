"""Routes on which exactly one technique is good at a time."""

from __future__ import annotations

import numpy as np

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.routes.route_model import RouteModel, no_repeats
from amusic_gym.routes.simulate import TECHNIQUE_NAMES, bank_of, generator
from amusic_gym.routes.simulated_descriptors import TechniqueModel
from amusic_gym.utils.checks import whole


def planted(
    seed: int,
    *,
    regimes: int | None = None,
    frames_per_regime: int = 100,
    techniques: int = 4,
    references: int = 1000,
    jumps: bool = False,
) -> ScoreBank:
    """A route on which exactly one technique is good at a time, and never the same twice running.

    All others see noise, so no fixed subset of few techniques is good on the whole route. The
    costs are nearly equal, so none is cheap either.

    Args:
        seed: non-negative integer; also decides the order of the techniques.
        regimes: stretches with one good technique each; None: as many as techniques. The first
            `techniques` of them all have different good ones.
        frames_per_regime: their length in frames.
        techniques: T, 2 to 26.
        references: places R of the map, at least regimes * frames_per_regime.
        jumps: the parts of the route are driven in reverse order (each of them forwards), so that
            every regime starts with a jump; else one steady drive.

    Raises:
        ValueError: an argument is out of range; the sentence says which.
    """
    rng = generator(seed)
    techniques = whole("techniques", techniques, 2, most=len(TECHNIQUE_NAMES))
    regimes = whole("regimes", techniques if regimes is None else regimes, 1)
    length = whole("frames_per_regime", frames_per_regime, 1)
    frames = regimes * length
    references = whole("references", references, 1)
    if references < frames:
        raise ValueError(
            f"references is {references}, but {regimes} regimes of {length} frames drive past "
            f"{frames} places; use at least {frames}."
        )
    order = no_repeats(rng, regimes, techniques)
    start = rng.integers(references - frames + 1)
    parts = np.arange(regimes)[:: -1 if jumps else 1]
    place = start + (parts[:, None] * length + np.arange(length)).ravel().astype(np.float64)
    shared = RouteModel(
        place=place,
        seen=place,
        condition=np.repeat(order, length),
        competence=0.95 * np.eye(techniques),
        source=np.arange(references),
        bland=np.zeros(references, np.float32),
    )
    models = [_PLANTED] * techniques
    seconds = rng.uniform(0.95, 1.05, techniques)
    return bank_of(rng, shared, models, seconds, 2, f"planted-{seed}")


# Sharp and without memory: useless means useless, and the good technique is found in one frame.
_PLANTED = TechniqueModel(
    trend=0.0,
    trend_length=1.0,
    dimensions=48,
    smoothness=1.0,
    grain=0.3,
    aliasing=0.0,
    bland=0.0,
    base=0.5,
    noise_memory=0.5,
    noise_grain=0.5,
    shift=0.3,
    lasting=0.0,
    bend=0.0,
    offset=0.5,
    scale=0.05,
)
