"""A localiser that a robot's own program pushes images into, one by one."""

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.extraction.place_map import PlaceMap
from amusic_gym.live.drives import FrameResult, drive_along
from amusic_gym.live.limits import Limits
from amusic_gym.policies.protocol import Context, Correction, Policy, Selector
from amusic_gym.policies.registry import make_policy
from amusic_gym.techniques.protocol import Image, Technique
from amusic_gym.utils.checks import number, share
from amusic_gym.utils.closing import Closing
from amusic_gym.utils.names import suggest
from amusic_gym.utils.states import read_state, write_state

COMPUTE_WEIGHT = 0.3
"""λ of a trained selector where none is named: in the middle of what `compare` runs."""

TOLERANCE = 2  # places that count as one when matches are compared, where none is named
KNOWN = 0.5  # estimated correctness from which a place counts as known, where nothing else is said


@dataclass(frozen=True, eq=False)
class Localisation:
    """Where one image was taken.

    Attributes:
        place: number of the place on the map, -1 before there is one.
        name: of the place's image; "" before.
        position: (latitude, longitude) in degrees, or metres as the map has them; None where the
            map has no positions, or there is no place.
        heading: degrees, likewise.
        p_correct: estimated probability that the place is right; None where the policy gives none.
        known: whether that is at least ``min_p``; None where there is none.
        active: names of the techniques that ran on the image.
        milliseconds: wall time of the update.
        stamp: of the image, as it was given.
        frame: images since the localiser began, or was reset, before this one.
        seen: all that the drive tells.
    """

    place: int
    name: str
    position: tuple[float, ...] | None
    heading: float | None
    p_correct: float | None
    known: bool | None
    active: tuple[str, ...]
    milliseconds: float
    stamp: float | None
    frame: int
    seen: FrameResult = field(repr=False)


class Pushed:
    """Frame source of images that are put into it."""

    name = "pushed images"
    length: int | None = None
    random_access = False

    def __init__(self) -> None:
        self.image: Image | None = None

    def read(self, frame: int) -> Image | None:
        """The image that waits, whatever the number."""
        image, self.image = self.image, None
        return image

    def rewind(self) -> None:
        """Nothing to do."""


class Localiser(Closing):
    """Recognises the places of a map in images that are pushed into it.

    It does what `navigate` does with the same images. See :meth:`load` for the arguments.
    """

    def __init__(
        self,
        place_map: PlaceMap,
        policy: str | Policy = "ppo",
        *,
        min_p: float = KNOWN,
        tolerance: int = TOLERANCE,
        seconds: Mapping[str, float] | None = None,
        compute_weight: float = COMPUTE_WEIGHT,
        statistic: str | None = None,
        seed: int = 0,
        **limits: Any,
    ) -> None:
        self.map = place_map
        self._closed = False
        self.min_p = share("min_p", min_p)
        self._source = Pushed()
        given = dict(zip(place_map.techniques, place_map.seconds.tolist(), strict=True))
        for name in seconds or {}:
            if name not in given:
                raise ValueError(suggest("technique", name, given))
        known = list({**given, **(seconds or {})}.values())
        within = Limits(**limits)
        route = LiveRoute(
            place_map.maps,
            self._source,
            tolerance=tolerance,
            seconds=within.costs(place_map.techniques, known),
            places=place_map.thumbnails,
            name=place_map.name,
        )
        chosen = SICSettings(statistic or SICSettings.statistic).statistic
        if isinstance(policy, str):
            within.check(policy)
            policy = make_policy(policy, Context.of(route, statistic=chosen, seed=seed))
        own = policy.needs.statistic if isinstance(policy, Selector) else None
        if statistic is not None and own not in (None, statistic):
            raise ValueError(
                f"statistic is {statistic!r}, but the policy needs {own!r} and takes no other;"
                " leave the statistic out, or take another policy"
            )
        measured = not given.keys() <= (seconds or {}).keys()
        keeper = within.keeper(
            policy, route.techniques, known, measured=measured, weight=compute_weight
        )
        how = Correction.under(policy, chosen)
        self._drive = drive_along(policy, route, how, compute_weight=compute_weight, keeper=keeper)
        where = place_map.positions
        self._where = None if where is None else where.coordinates()
        kind = type(policy)
        self._about = {  # what a saved state must agree with
            "map": place_map.digest,
            "policy": f"{kind.__module__}.{kind.__qualname__}",
            "statistic": chosen,
            "tolerance": tolerance,
            "compute_weight": compute_weight,
            "seconds": route.seconds.tolist(),
            **limits,
        }
        self._begin()

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        policy: str | Policy = "ppo",
        *,
        techniques: Sequence[Technique] = (),
        weights: Mapping[str, str | Path] | None = None,
        threads: int | None = None,
        **options: Any,
    ) -> Self:
        """A localiser on a map's folder.

        Args:
            path: the folder, which ``amusic map build`` or `build_map` wrote.
            policy: as on the command line, or a policy of your own.
            techniques: see `PlaceMap.load`.
            weights: likewise.
            threads: likewise.
            options: ``min_p``: estimated correctness from which a place counts as known;
                ``tolerance``: places that count as one when matches are compared; ``seconds``:
                technique's name -> what a run costs here, in place of what it cost where the map
                was made; ``compute_weight``: λ; ``statistic``, of policies that bring none;
                ``seed`` of a policy that draws; ``budget_ms``, ``budget_fps``, or
                ``budget_joules`` with ``joules``, and ``cap_ms``: see
                :class:`~amusic_gym.live.limits.Limits`. With ``seconds`` of all techniques frames
                are charged with these, else with the wall time that they take.

        Raises:
            FileNotFoundError: as `PlaceMap.load`, or for a policy that is not there.
            ValueError: likewise, and for options out of range.
        """
        found = PlaceMap.load(path, techniques=techniques, weights=weights, threads=threads)
        return cls(found, policy, **options)

    def _begin(self) -> None:
        self._count = 0
        self._last = -math.inf
        self._everything = False

    def update(self, image: ArrayLike, stamp: float | None = None) -> Localisation:
        """Recognise the place of the next image.

        Args:
            image: (height, width, 3) uint8, blue-green-red, or (height, width) grey.
            stamp: seconds, rising from image to image; it is handed on.

        Raises:
            ValueError: of a closed localiser; for what is no image, a stamp that does not rise, or
                an image that a technique cannot take; after that, :meth:`reset` or
                :meth:`relocalise`.
        """
        if self._closed:
            raise ValueError("the localiser is closed; load it anew")
        if stamp is not None and number("stamp", stamp, "seconds") <= self._last:
            raise ValueError(
                f"stamp is {stamp}, not after {self._last}; give images in their order"
            )
        self._source.image = _checked(image)
        seen = self._drive.step(everything=self._everything)
        assert seen is not None
        self._everything = False
        self._last = self._last if stamp is None else stamp
        self._count += 1
        place, p = seen.prediction, seen.p_correct
        position = heading = None
        if place >= 0 and self._where is not None and self.map.positions is not None:
            position = tuple(self._where[place].tolist())
            headings = self.map.positions.headings
            heading = None if headings is None else float(headings[place])
        return Localisation(
            place=place,
            name=self.map.names[place] if place >= 0 else "",
            position=position,
            heading=heading,
            p_correct=p,
            known=None if p is None else p >= self.min_p,
            active=seen.active,
            milliseconds=seen.milliseconds,
            stamp=stamp,
            frame=self._count - 1,
            seen=seen,
        )

    def track(self, images: Iterable[ArrayLike]) -> Iterator[Localisation]:
        """An update for each of some images, as they come."""
        return map(self.update, images)

    def reset(self) -> None:
        """Begin anew, as after loading; a policy that draws goes on drawing."""
        self._drive.begin()
        self._begin()

    def relocalise(self) -> None:
        """Forget where the robot was, which somebody has carried away.

        All techniques run on the next image; frames and stamps count on.
        """
        self._drive.begin()
        self._everything = True

    def save_state(self, path: str | os.PathLike[str]) -> Path:
        """Write what is remembered of the drive, so that another process goes on from it.

        Raises:
            TypeError: for a policy of your own that holds what is no plain data.
            OSError: when it cannot be written; what was there is still there.
        """
        arrays: dict[str, Any] = {}
        own = {"count": self._count, "last": self._last, "everything": self._everything}
        tree = {"about": self._about, "own": own, "drive": self._drive.save(arrays)}
        return write_state(Path(path), tree, arrays)

    def load_state(self, path: str | os.PathLike[str]) -> None:
        """Go on from what :meth:`save_state` wrote, with the very same results.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it is damaged, or of another map, policy or setting; the localiser
                then begins anew.
        """
        tree, arrays = read_state(Path(path))
        about = tree["about"]
        for name in {**self._about, **about}:
            if (there := about.get(name)) != (here := self._about.get(name)):
                raise ValueError(
                    f"{os.fspath(path)} was saved with {name} {there}, here it is {here}; load the"
                    " same map with the same policy and options, or begin anew"
                )
        self.reset()
        try:
            self._drive.restore(tree["drive"], arrays)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            self.reset()
            raise ValueError(
                f"{os.fspath(path)} was saved by another version ({error}); begin anew"
            ) from None
        own = tree["own"]
        self._count, self._last, self._everything = own["count"], own["last"], own["everything"]

    def close(self) -> None:
        """End the threads that match; nothing can be recognised from now on."""
        self._closed = True
        self.map.close()


def _checked(image: ArrayLike) -> Image:
    """A copy of an image: a camera may use its memory again."""
    array = np.array(image)
    grey = array.ndim == 2
    if (
        array.dtype != np.uint8
        or not (grey or (array.ndim == 3 and array.shape[2] == 3))
        or 0 in array.shape
    ):
        raise ValueError(
            f"the image has shape {array.shape} and type {array.dtype}; give (height, width, 3)"
            " uint8, blue-green-red, or (height, width) grey"
        )
    return np.repeat(array[..., None], 3, axis=2) if grey else array
