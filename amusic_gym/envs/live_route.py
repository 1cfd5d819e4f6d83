"""Live routes: techniques run on images when the environment asks for their scores.

A :class:`LiveRoute` stands where a score bank may stand. The map is described beforehand; the
query's images come from a frame source (:mod:`amusic_gym.envs.frames`), and only what the policy
runs is computed.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.banks.costs import COST_MODELS, check_seconds, paper_seconds
from amusic_gym.banks.ground_truth import GroundTruth, check_tolerance, resolve_ground_truth
from amusic_gym.banks.scores import check_names
from amusic_gym.envs.frames import FrameSource, Indexed, as_frames
from amusic_gym.techniques.protocol import Descriptor, Image, Technique
from amusic_gym.utils.checks import flag
from amusic_gym.utils.names import suggest

if TYPE_CHECKING:
    from amusic_gym.envs.live_rows import LiveRows
    from amusic_gym.estimation.settings import SICSettings

ENDLESS = 2**40
"""Frames of a route whose length is not known."""

REPEATS = 5
"""Runs of which the median is a technique's declared cost, after one that warms up."""


class Map(Protocol):
    """The reference traverse, described by one technique (amusic_gym.extraction.map)."""

    @property
    def technique(self) -> Technique:
        """What described it."""
        ...

    @property
    def references(self) -> int:
        """R, places on the map."""
        ...

    def describe_query(self, image: Image) -> Descriptor:
        """Descriptor of a query image, with the bits that a bank is made of."""
        ...

    def scores(self, query: Descriptor) -> NDArray[np.float32]:
        """(R,) float32 scores of a query, with the bits that a bank has."""
        ...


class SourceOwner:
    """Who drives a source that only one may drive: the one that began last."""

    turn = 0


class LiveRoute:
    """A map and a source of query images, where a score bank may be given.

    It does not change and is shared by copies; what a drive along it computes belongs to the
    environment's route. Costs are the declared seconds, as with a bank, so that the same images
    give the same observations and rewards, bit for bit.

    Args:
        maps: the map, described by each technique.
        frames: folder, :class:`~amusic_gym.envs.frames.FrameSource`, images that can be indexed,
            or an iterator of images.
        tolerance: places to either side of the true one that count as right. None only where
            ``ground_truth`` lists the true places itself.
        ground_truth: None: not known | what :class:`~amusic_gym.banks.bank.ScoreBank` takes.
        seconds: (T,) declared cost of one run; None: measured, warm, on the first frame.
        costs: the cost model that ``seconds`` belong to; without ``seconds``, the one to use.
        charge_wall_time: charge a step with the seconds that its runs took, not with declared
            ones. Observations and rewards are then no longer repeatable.
        name: what to call the route; by default, the source's name.
        places: the map's R images, for pictures.

    Raises:
        ValueError: for no map, maps or ``places`` of different size, unusable names or costs, a
            source without a frame, scores of the wrong shape, NaN or +∞.

    Attributes:
        techniques: T names.
        seconds: (T,) float64, declared cost of one run under the cost model ``costs``.
        references: R, places on the map.
        queries: Q; None where the source does not know how long it is.
        truth: which places are true for each query; None where that is not known.
        tolerance: places.
    """

    def __init__(
        self,
        maps: Sequence[Map],
        frames: str | os.PathLike[str] | FrameSource | Indexed | Iterable[Image],
        *,
        tolerance: int | None = None,
        ground_truth: ArrayLike | GroundTruth | None = None,
        seconds: ArrayLike | None = None,
        costs: str = "measured",
        charge_wall_time: bool = False,
        name: str = "",
        places: Indexed | None = None,
    ) -> None:
        self.maps = tuple(maps)
        if not self.maps:
            raise ValueError("no map; give at least one")
        self.techniques = check_names([one.technique.name for one in self.maps])
        self.references = _references(self.maps)
        self.frames = as_frames(frames)
        self.queries = self.frames.length
        self.name = name or self.frames.name
        if places is not None and len(places) != self.references:
            raise ValueError(
                f"live route {self.name!r}: {len(places)} images of a map of {self.references}"
                " places; give places=, the images that the map was described from"
            )
        self.places = places
        self.truth, self.tolerance = self._truth(ground_truth, tolerance)
        self.charge_wall_time = flag("charge_wall_time", charge_wall_time)
        self.owner = SourceOwner()
        if costs not in COST_MODELS:
            raise ValueError(suggest("cost model", costs, COST_MODELS))
        given = costs if seconds is not None else "measured"
        array = self._measure() if seconds is None else np.asarray(seconds)
        self._given = (given, check_seconds(array, self.techniques))
        self._charge(costs)

    def _truth(
        self, ground_truth: ArrayLike | GroundTruth | None, tolerance: int | None
    ) -> tuple[GroundTruth | None, int]:
        if ground_truth is None:
            return None, check_tolerance(tolerance)
        if self.queries is None:
            raise ValueError(
                f"live route {self.name!r}: ground truth for a source of unknown length; leave it"
                " out, or give a folder of images"
            )
        return resolve_ground_truth(ground_truth, tolerance, self.queries, self.references)

    def _measure(self) -> NDArray[np.float64]:
        """(T,) median seconds of a run on the first frame, after one that warms up."""
        from amusic_gym.extraction.seconds import cost_of

        self.frames.rewind()
        image = self.frames.read(0)
        if image is None:
            raise ValueError(f"live route {self.name!r} has no frame; give at least one image")
        costs = []
        for t, technique in enumerate(self.techniques):
            runs = [self.run(t, image, 0)[1:] for _ in range(1 + REPEATS)]
            costs.append(cost_of(runs[1:]))
            costs[-1].warn(technique)
        return np.array([cost.seconds for cost in costs])

    def _charge(self, costs: str) -> None:
        """Set the declared seconds of a cost model."""
        given, seconds = self._given
        if self.charge_wall_time and costs != "measured":
            raise ValueError(
                f"charge_wall_time with costs {costs!r}: wall time compares with measured seconds"
                " only; use costs 'measured'"
            )
        if costs == "runs":
            seconds = check_seconds(np.ones(len(self.techniques)), self.techniques)
        elif costs == "paper":
            seconds = paper_seconds(self.techniques)
        elif costs != given:
            raise ValueError(
                f"seconds of the cost model {given!r} are no measured ones; give these"
            )
        self.costs, self.seconds = costs, seconds

    def with_costs(self, model: str) -> LiveRoute:
        """The same route with the seconds of another cost model.

        Raises:
            ValueError: for an unknown model; for ``paper`` with a technique that the paper does
                not time; for ``measured`` where other seconds were given.
        """
        if model not in COST_MODELS:
            raise ValueError(suggest("cost model", model, COST_MODELS))
        view = LiveRoute.__new__(LiveRoute)
        view.__dict__.update(self.__dict__)
        view._charge(model)
        return view

    def with_seconds(self, seconds: ArrayLike) -> LiveRoute:
        """The same route with other declared costs (T,) of a run, in whatever unit."""
        view = LiveRoute.__new__(LiveRoute)
        view.__dict__.update(self.__dict__)
        view.seconds = check_seconds(np.asarray(seconds), self.techniques)
        return view

    def run(self, technique: int, image: Image, frame: int) -> tuple[NDArray[np.float32], float]:
        """Run a technique on an image.

        Args:
            technique: its index.
            image: the image.
            frame: its number, for messages.

        Returns:
            The score row (R,) and the seconds that it took.

        Raises:
            ValueError: for a row of the wrong shape, NaN or +∞ as a score, or an image that the
                technique refuses; each names technique and frame.
        """
        one = self.maps[technique]
        who = f"technique {self.techniques[technique]!r}"
        where = f"{who} at frame {frame} of {self.name!r}"
        own = np.array(image)  # a technique may draw on it; others and the picture need it as it is
        begin = time.perf_counter()
        try:
            row = one.scores(one.describe_query(own))
        except ValueError as error:
            said = str(error)
            rest = said.removeprefix(who) if said.startswith(who) else f": {said}"
            raise ValueError(f"{where}{rest}") from error
        seconds = time.perf_counter() - begin
        return _checked(row, self.references, where), seconds

    def drive(self, start: int, settings: SICSettings, block: int) -> LiveRows:
        """Begin a drive along the route.

        Args:
            start: the source's frame that is frame 0.
            settings: SIC's; its K and F say what has to be kept.
            block: M of the re-select bit, or 0.
        """
        from amusic_gym.envs.live_rows import LiveRows

        return LiveRows(self, start, settings, block)

    def __copy__(self) -> LiveRoute:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> LiveRoute:
        return self  # it does not change, and a map is large

    def __getstate__(self) -> dict[str, Any]:
        """The route for a pickle.

        Raises:
            TypeError: where the source can only be read here.
        """
        if not self.frames.random_access:
            raise TypeError(
                f"live route {self.name!r} cannot be pickled: its {type(self.frames).__name__} can"
                " be read in this process only; use a folder of images"
            )
        return self.__dict__

    def __repr__(self) -> str:
        return (
            f"LiveRoute({self.name!r}, techniques={self.techniques}, queries={self.queries},"
            f" references={self.references}, tolerance={self.tolerance}, costs={self.costs!r})"
        )


def _references(maps: Sequence[Map]) -> int:
    """R, the same for all maps."""
    sizes = {one.technique.name: one.references for one in maps}
    if len(set(sizes.values())) != 1 or min(sizes.values()) < 1:
        listed = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise ValueError(
            f"maps of {listed} places; describe the same reference with each technique"
        )
    return next(iter(sizes.values()))


def _checked(row: Any, references: int, where: str) -> NDArray[np.float32]:
    """A score row (R,) float32, refused if it is none."""
    scores = np.asarray(row)
    if scores.shape != (references,) or scores.dtype.kind not in "fiub":
        raise ValueError(
            f"{where} gave scores of shape {scores.shape} and dtype {scores.dtype}; match must give"
            f" one number for each of the {references} places"
        )
    scores = scores.astype(np.float32, copy=False)
    if not (scores < np.inf).all():
        place = int(np.argmin(scores < np.inf))
        raise ValueError(
            f"{where} gave {scores[place]} as score of place {place}; every score must be finite,"
            " or −∞ for a place that is no candidate: mend the technique"
        )
    return scores
