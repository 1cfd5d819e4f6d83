"""Two image folders and some techniques to a score bank."""

import os
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.banks import bank_files
from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.costs import declared_seconds
from amusic_gym.banks.descriptors import DescriptorPair
from amusic_gym.banks.ground_truth import GroundTruth, resolve_ground_truth
from amusic_gym.banks.loop_closure import rows_without_recent, truth_without_recent
from amusic_gym.banks.scores import check_names
from amusic_gym.extraction.cache import Cache, opened
from amusic_gym.extraction.describe import ExtractionPlan, images_of, match, score_rows
from amusic_gym.extraction.executors import make_executor
from amusic_gym.extraction.progress import Progress
from amusic_gym.extraction.seconds import known_cost
from amusic_gym.extraction.shards import Executor
from amusic_gym.routes.bank_images import BankImages
from amusic_gym.routes.folders import Folder, check_apart, folder_of
from amusic_gym.routes.image_truth import by_index
from amusic_gym.techniques import Technique, make_technique


def extract(
    reference: Folder,
    query: Folder,
    techniques: Sequence[Technique | str] | Technique | str,
    *,
    tolerance: int | None = None,
    ground_truth: ArrayLike | GroundTruth | None = None,
    exclude_recent: int | None = None,
    descriptors: Sequence[DescriptorPair] = (),
    seconds: Mapping[str, float] | None = None,
    measure_again: bool = False,
    cache: str | os.PathLike[str] | Cache | None = None,
    executor: str = "serial",
    out: str | os.PathLike[str] | None = None,
    name: str = "",
    source: str = "",
    progress: bool = False,
) -> ScoreBank:
    """Run techniques on two traverses and keep the scores as a bank.

    Every piece that is finished goes to the cache, so a run that was stopped goes on where it
    was, and the same call again only reads. With given ``seconds`` the bank is the same, byte for
    byte, whatever the executor.

    Args:
        reference: the map, R images: an `ImageFolder` or a path.
        query: the run, Q images.
        techniques: objects, or names as `amusic_gym.techniques.make_technique` takes them; one
            or several.
        tolerance: places to either side of the true one that count as right; see `ScoreBank`.
        ground_truth: see `ScoreBank`, and `amusic_gym.routes.image_truth` for more ways; None:
            query q is at place q, in joined folders part by part.
        exclude_recent: for one sequence against itself: how many frames before each are no
            candidates, besides itself and those after it; None: every place is one.
        descriptors: of further techniques, in the order of the images
            (`amusic_gym.routes.descriptor_files.read_descriptors`).
        seconds: technique name → seconds of one run, for those that are not to be measured here;
            those of ``descriptors`` cannot be.
        measure_again: measure the seconds even if the cache remembers them of this machine.
        cache: the cache's folder, or an open cache; None: the default one.
        executor: ``serial``, ``process:N``, ``ray`` or ``ray:ADDRESS``.
        out: the bank's folder to write; None: the bank stays in memory, all of it. With it,
            memory holds some blocks of descriptors at a time and never all scores.
        name: what to call the bank; by default its folder's name.
        source: where the scores come from; by default the two folders' names.
        progress: show bars on a terminal, and a line per technique.

    Returns:
        The bank; memory-mapped where ``out`` is given.

    Raises:
        FileNotFoundError: for a folder, an image or a weights file that is not there.
        ValueError: for bad arguments, before any work begins; for an image that cannot be
            described, naming it.
        OSError: when the bank or the cache cannot be written.
        ChildProcessError: when workers die of the same shard again and again.
    """
    where = make_executor(executor)
    techniques = [techniques] if isinstance(techniques, Technique | str) else techniques
    made = [make_technique(each) if isinstance(each, str) else each for each in techniques]
    further = [pair.technique for pair in descriptors]
    names = check_names([*(technique.name for technique in made), *further])
    declared = declared_seconds(seconds or {}, names)
    for each in further:
        if each not in declared:
            raise ValueError(
                f"technique {each!r} is given by its descriptors, and its seconds cannot be "
                f"measured; give them (--seconds {each}=S)"
            )
    if out is not None:
        _check_writable(Path(out))
    map_folder, run_folder = folder_of(reference), folder_of(query)
    check_apart(map_folder, run_folder)
    if ground_truth is None and tolerance is not None:
        ground_truth = by_index(map_folder, run_folder, tolerance, exact=True)
    truth, places = resolve_ground_truth(ground_truth, tolerance, len(run_folder), len(map_folder))
    for pair in descriptors:
        pair.check_counts(len(map_folder), len(run_folder))
    references, queries = images_of(map_folder), images_of(run_folder)
    if exclude_recent is not None:
        truth = truth_without_recent(truth, exclude_recent)
    plans = [ExtractionPlan(technique, references, queries) for technique in made]
    say = Progress(progress)
    with ExitStack() as stack:
        store = stack.enter_context(opened(cache))
        stack.enter_context(where)
        costs = [
            _run(plan, store, where, say, declared.get(plan.technique.name), measure_again)
            for plan in plans
        ]
        advance = stack.enter_context(say.bar("descriptors", sum(map(len, descriptors)), "pairs"))
        rows: Iterator[NDArray[np.float32]] = chain(
            (block for plan in plans for block in score_rows(plan, store)),
            (block for pair in descriptors for block in pair.score_rows(advance)),
        )
        if exclude_recent is not None:
            rows = rows_without_recent(rows, truth.queries, exclude_recent)
        bank = ScoreBank.from_rows(
            rows,
            names,
            [*costs, *(declared[each] for each in further)],
            truth=truth,
            tolerance=places,
            name=name,
            source=source or f"images: {run_folder.path.name} on {map_folder.path.name}",
            out=out,
        )
    if bank.path is not None:
        BankImages.of(run_folder, map_folder).save(bank.path)
    return bank


def _run(
    plan: ExtractionPlan,
    cache: Cache,
    where: Executor,
    say: Progress,
    declared: float | None,
    again: bool,
) -> float:
    """All shards of one technique; returns its seconds."""
    begun = time.monotonic()
    with where.workers(plan.technique) as workers:
        pairs = match(plan, cache, workers, say)
        if declared:
            cost, told = declared, f"{declared:.4g} s per run"
        else:
            measured = known_cost(plan, cache, workers, say, again=again)
            cost, told = measured.seconds, str(measured)
    known = "" if pairs else ", all from the cache"
    say.line(
        f"{plan.technique.name}: {len(plan.query)} queries × {len(plan.reference)} places in "
        f"{time.monotonic() - begun:.1f} s{known}; "
        f"{told}"
    )
    return cost


def _check_writable(out: Path) -> None:
    """Refuse a bank's folder that cannot be written, before long work is begun for it."""
    bank_files.check_destination(out)
    parent = Path(os.path.realpath(out)).parent
    try:
        with tempfile.TemporaryFile(dir=parent):
            pass
    except OSError as error:
        raise OSError(
            error.errno,
            f"the bank {out} cannot be written, nothing can be in {parent} ({error.strerror})",
        ) from error
