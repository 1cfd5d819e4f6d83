"""The ranked list of each query of a trace, as CSV."""

import io
from pathlib import Path

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ranking import ranked
from amusic_gym.policies.trace import Trace
from amusic_gym.utils.escaping import CsvWriter
from amusic_gym.utils.storage import write_whole

COLUMNS = ("query", "rank", "place", "correct")


def write_lists(path: str | Path, bank: ScoreBank, trace: Trace, count: int) -> Path:
    """Write a line per query and rank, 1 to ``count`` at most, whole or not at all.

    The columns are `COLUMNS`; what is ranked is said in `amusic_gym.banks.ranking`.
    """
    text = io.StringIO()
    writer = CsvWriter(text)
    writer.writerow(COLUMNS)
    for frame, prediction in enumerate(trace.predictions.tolist()):
        for rank, place in enumerate(ranked(bank, frame, trace.ran[frame], prediction, count), 1):
            right = bank.truth.is_true(int(place), frame)
            writer.writerow([frame, rank, int(place), int(right)])
    return write_whole(path, text.getvalue().encode())
