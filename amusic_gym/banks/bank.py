"""Score banks: the similarity of every query frame to every place, by every technique."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.banks import bank_files
from amusic_gym.banks.costs import COST_MODELS, check_seconds, paper_seconds
from amusic_gym.banks.ground_truth import GroundTruth, resolve_ground_truth
from amusic_gym.banks.scores import as_scores, check_names, check_rows, read_only
from amusic_gym.utils.names import suggest

if TYPE_CHECKING:
    from amusic_gym.banks.rows import PreparedRows


__all__ = ["GroundTruth", "ScoreBank"]

_preparing = threading.Lock()  # threads that share a bank share what is prepared of it, too


class ScoreBank:
    """Scores of a query traverse against a map, with names, costs and ground truth.

    A bank does not change: its arrays are read-only. One loaded from disk is memory-mapped;
    copies share it, and pickles carry only its path. `subset` and `with_costs` give views of the
    same scores.

    Args:
        scores: (T, Q, R) numbers, higher = more similar, −∞ for a place that is no candidate;
            kept as float32. Copied, unless it is a float32 memory map opened read-only.
        techniques: T different names, in the order of the scores.
        seconds: (T,) seconds of one run of each technique on one frame, > 0.
        tolerance: places to either side of the true one that count as right. None only where
            ``ground_truth`` lists the true places itself: then half the median run of neighbours
            among them.
        ground_truth: None (query q is at place q) | (Q, R) boolean | (Q,) integer places, -1 for
            a query without a true place | GroundTruth.
        name: what to call the bank in tables; by default, its folder's name once on disk.
        source: where the scores come from, for the reader of the bank.
        costs: the cost model that ``seconds`` belong to, one of `COST_MODELS`.

    Raises:
        ValueError: for shapes that do not fit, scores of NaN or +∞, names that are empty,
            repeated or ambiguous on a command line, seconds that are not positive.

    Attributes:
        stored: (T0, Q, R) float32, read-only, the scores of the bank on disk or in memory.
        index: (T,) int64, where in ``stored`` each technique of this bank is.
        techniques: T names.
        seconds: (T,) float64, cost of one run under the cost model ``costs``.
        tolerance: places.
        truth: which places are true for each query.
        path: the folder it was loaded from; None in memory.
    """

    def __init__(
        self,
        scores: ArrayLike,
        techniques: Sequence[str],
        seconds: ArrayLike,
        *,
        tolerance: int | None = None,
        ground_truth: ArrayLike | GroundTruth | None = None,
        name: str = "",
        source: str = "",
        costs: str = "measured",
    ) -> None:
        stored = as_scores(scores)
        names = check_names(techniques, len(stored))
        truth, places = resolve_ground_truth(ground_truth, tolerance, *stored.shape[1:])
        self._set(stored, names, check_seconds(seconds, names), places, truth, name, source, costs)
        self.check_finite()

    def _set(
        self,
        stored: NDArray[np.float32],
        techniques: tuple[str, ...],
        seconds: NDArray[np.float64],
        tolerance: int,
        truth: GroundTruth,
        name: str,
        source: str,
        costs: str,
    ) -> None:
        if costs not in COST_MODELS:
            raise ValueError(suggest("cost model", costs, COST_MODELS))
        self.stored = stored
        self.index: NDArray[np.int64] = np.arange(len(stored))
        self.techniques = techniques
        self.seconds = seconds
        self.tolerance = tolerance
        self.truth = truth
        self.name = name
        self.source = source
        self.costs = costs
        self.path: Path | None = None
        self._fingerprint = ""  # of the folder's bank.json, for pickles
        self._given = (costs, seconds)  # the cost model that came with the scores
        self._prepared: dict[int, PreparedRows] = {}

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, Q, R): techniques, queries, references."""
        return len(self.index), self.stored.shape[1], self.stored.shape[2]

    @property
    def queries(self) -> int:
        """Q, frames of the query traverse."""
        return self.shape[1]

    @property
    def references(self) -> int:
        """R, places on the map."""
        return self.shape[2]

    @property
    def scores(self) -> NDArray[np.float32]:
        """(T, Q, R) float32, read-only: a view; a copy where a subset is out of order."""
        first, count = int(self.index[0]), len(self.index)
        if np.array_equal(self.index, np.arange(first, first + count)):
            return self.stored[first : first + count]
        copy = self.stored[self.index]
        copy.flags.writeable = False
        return copy

    def row(self, technique: int, query: int) -> NDArray[np.float32]:
        """(R,) scores of one technique on one query frame, a contiguous read-only view."""
        view: NDArray[np.float32] = self.stored[self.index[technique], query]
        return view

    def prepared(self, candidates: int) -> PreparedRows:
        """What SIC knows of each row, shared by all who use this bank with ``candidates`` = K."""
        from amusic_gym.banks.rows import PreparedRows

        with _preparing:
            if candidates not in self._prepared:
                self._prepared[candidates] = PreparedRows(self, candidates)
            return self._prepared[candidates]

    def check_finite(self) -> None:
        """Read every score once; refuses the first that is NaN or +∞, by technique and frame."""
        for technique, stored in zip(self.techniques, self.index, strict=True):
            check_rows(technique, self.stored[stored])

    def subset(self, names: Sequence[str]) -> ScoreBank:
        """The same bank with the techniques ``names`` only, in that order.

        Raises:
            ValueError: for an unknown or repeated name.
        """
        chosen = check_names(names)
        for name in chosen:
            if name not in self.techniques:
                raise ValueError(suggest("technique", name, self.techniques))
        at = [self.techniques.index(name) for name in chosen]
        view = self._view()
        view.index = self.index[at]
        view.techniques = chosen
        view.seconds = read_only(self.seconds[at])
        view._given = (self._given[0], read_only(self._given[1][at]))
        view._prepared = {}
        return view

    def with_costs(self, model: str) -> ScoreBank:
        """The same bank with the seconds of another cost model, one of `COST_MODELS`.

        Raises:
            ValueError: for an unknown model; for ``paper`` with a technique that the paper does
                not time; for ``measured`` when the bank was built with other costs.
        """
        if model not in COST_MODELS:
            raise ValueError(suggest("cost model", model, COST_MODELS))
        view = self._view()
        view.costs = model
        given, seconds = self._given
        if model == given:
            view.seconds = seconds
        elif model == "runs":
            view.seconds = read_only(np.ones(len(self.techniques)))
        elif model == "paper":
            view.seconds = paper_seconds(self.techniques)
        else:
            raise ValueError(
                f"the bank holds the seconds of the cost model {given!r}, not measured ones; "
                f"use costs {given!r} or 'runs', or build the bank with measured seconds"
            )
        return view

    def _view(self) -> ScoreBank:
        view = ScoreBank.__new__(ScoreBank)
        view.__dict__.update(self.__dict__)  # the rows prepared so far are shared too
        return view

    @property
    def folder(self) -> Path | None:
        """Where :meth:`load` finds the same bank; None: nowhere, or it is a view of another."""
        whole = np.array_equal(self.index, np.arange(len(self.stored)))
        return self.path if whole and self.costs == self._given[0] else None

    @classmethod
    def from_rows(
        cls,
        rows: Iterable[NDArray[np.float32]],
        techniques: Sequence[str],
        seconds: ArrayLike,
        *,
        truth: GroundTruth,
        tolerance: int,
        name: str,
        source: str,
        costs: str = "measured",
        out: str | os.PathLike[str] | None = None,
    ) -> ScoreBank:
        """A bank from its score rows, in memory or written to a folder as they come.

        Args:
            rows: (n, R) matrices that together are the T · Q rows, technique after technique.
            techniques: as for the class; so are ``seconds``, ``name``, ``source`` and ``costs``.
            seconds: (T,).
            truth: of Q queries on R places.
            tolerance: places.
            name: of the bank.
            source: where the scores come from.
            costs: cost model of the seconds.
            out: the folder to write; None: the bank stays in memory.

        Raises:
            ValueError: as for the class; when ``out`` is something other than a bank.
            OSError: when the folder cannot be written; what was there is still there then.
        """
        names = check_names(techniques)
        checked = check_seconds(seconds, names)
        if out is None:
            shape = len(names), truth.queries, truth.references
            return cls(
                np.concatenate(list(rows)).reshape(shape),
                names,
                checked,
                tolerance=tolerance,
                ground_truth=truth,
                name=name,
                source=source,
                costs=costs,
            )
        bank_files.write(
            Path(out),
            scores=rows,
            truth=truth,
            techniques=list(zip(names, checked.tolist(), strict=True)),
            tolerance=tolerance,
            name=name,
            source=source,
            costs=costs,
        )
        return cls.load(out)

    @classmethod
    def load(cls, path: str | os.PathLike[str], *, verify: bool = False) -> ScoreBank:
        """Open a bank's folder; the scores are memory-mapped, not read.

        Args:
            path: the folder.
            verify: also read all scores and compare their checksum.

        Raises:
            FileNotFoundError: when the folder or one of its files is missing.
            ValueError: when it is damaged or from a newer format.
        """
        path = Path(os.path.realpath(path))
        scores, truth, manifest = bank_files.read(path, verify=verify)
        bank = cls.__new__(cls)
        try:
            names = check_names([each["name"] for each in manifest["techniques"]], len(scores))
            seconds = check_seconds([each["seconds"] for each in manifest["techniques"]], names)
            tolerance, source, costs = (manifest[key] for key in ("tolerance", "source", "costs"))
            name = manifest["name"] or path.name
            bank._set(scores, names, seconds, tolerance, truth, name, source, costs)
        except ValueError as error:
            raise ValueError(f"bank {path}: {error}") from None
        bank.path = path
        bank._fingerprint = manifest["sha256"]
        return bank

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the bank as a folder, whole or not at all; a bank that is there is replaced.

        Returns:
            The folder's absolute path.

        Raises:
            ValueError: when ``path`` is something other than a bank.
            OSError: when writing fails; what was at ``path`` is still there then.
        """
        written = ScoreBank.from_rows(
            (self.stored[stored] for stored in self.index),
            self.techniques,
            self.seconds,
            truth=self.truth,
            tolerance=self.tolerance,
            name=self.name,
            source=self.source,
            costs=self.costs,
            out=path,
        )
        return written.path or Path(path)

    def __copy__(self) -> ScoreBank:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> ScoreBank:
        return self  # it does not change: copying a memory map would read it whole

    def __reduce__(self) -> tuple[Any, ...]:
        if self.path is not None:
            return _reload, (str(self.path), self._fingerprint, self.techniques, self.costs)
        costs, seconds = self._given
        options = {
            "tolerance": self.tolerance,
            "ground_truth": self.truth,
            "name": self.name,
            "source": self.source,
            "costs": costs,
        }
        return _rebuild, (self.scores, self.techniques, seconds, options, self.costs)

    def __repr__(self) -> str:
        return (
            f"ScoreBank({self.name!r}, techniques={self.techniques}, shape={self.shape}, "
            f"tolerance={self.tolerance}, costs={self.costs!r}, path={str(self.path)!r})"
        )


def _reload(path: str, fingerprint: str, techniques: tuple[str, ...], costs: str) -> ScoreBank:
    bank = ScoreBank.load(path)
    if bank._fingerprint != fingerprint:
        raise ValueError(
            f"the bank {path} was replaced by another one since it was pickled; load it anew"
        )
    if bank.techniques != techniques:
        bank = bank.subset(techniques)
    return bank if bank.costs == costs else bank.with_costs(costs)


def _rebuild(
    scores: NDArray[np.float32],
    techniques: tuple[str, ...],
    seconds: NDArray[np.float64],
    options: dict[str, Any],
    costs: str,
) -> ScoreBank:
    bank = ScoreBank(scores, techniques, seconds, **options)
    return bank if costs == bank.costs else bank.with_costs(costs)
