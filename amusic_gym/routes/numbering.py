"""File names of a traverse: their order, and numbers that are missing or used twice."""

import os
import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from pathlib import PurePath

GAP = Fraction(3, 2)  # a step of so many usual ones leaves a number out

HOW = "give the order as a list of names (--order FILE, or order= of ImageFolder)"
"""What to do where names do not tell the order."""

# A minus is a sign at the beginning of a name, and behind "_", "@", "=", "(", "," or a blank.
_NUMBER = re.compile(r"((?:(?<![^_ @=(,])-)?[0-9]+(?:\.[0-9]+)*)")
_DECIMAL = re.compile(r"(?<![0-9.])([0-9]+)\.([0-9]+)(?!\.?[0-9])")
_HEXADECIMAL = re.compile(r"(.*[^0-9a-f])?([0-9a-f]+)", re.DOTALL)
_COUNTED = 0.95  # share of steps that are the usual one, from which on hexadecimal digits count
_FEW = 3  # steps that tell nothing of whether they are even
_HASH = 8  # hexadecimal digits without order, from which on they are no number

_MONTHS = "jan feb mar apr may jun jul aug sep oct nov dec".split()
_MONTH = rf"[-_. ]?({'|'.join(_MONTHS)})[a-z]{{0,6}}[-_., ]{{0,2}}"
_DAY, _YEAR = r"(?<![0-9])([0-9]{1,2})", r"((?:19|20)[0-9]{2})(?![0-9])"
_WORDY_DATES = (  # with the places of year, month and day among the groups
    (re.compile(_DAY + _MONTH + _YEAR), (3, 2, 1)),
    (re.compile(_MONTH + r"([0-9]{1,2})[-_., ]{1,2}" + _YEAR), (3, 1, 2)),
    (re.compile(r"(?<![0-9])((?:19|20)[0-9]{2})" + _MONTH + r"([0-9]{1,2})(?![0-9])"), (1, 2, 3)),
)
_DATE = re.compile(_DAY + r"([-_. ])([0-9]{1,2})\2" + _YEAR)
_HALF_DAY = re.compile(
    r"(?<![0-9])(1[0-2]|0?[1-9])((?:[-.:_h ][0-5]?[0-9]){1,2})[ _-]?([ap])m(?![a-z])"
)

NaturalKey = tuple[tuple[str | tuple[Fraction, ...], ...], str]


def natural_key(text: str) -> NaturalKey:
    """Sort key by which img2 comes before img10; upper and lower case only break ties.

    One point between digits makes a decimal fraction; several, as in a date, part whole numbers.

    >>> sorted(["img10", "IMG2", "img1"], key=natural_key)
    ['img1', 'IMG2', 'img10']
    >>> sorted(["7.1", "7.033", "-7", "-10"], key=natural_key)
    ['-10', '-7', '7.033', '7.1']
    """
    # Splitting at numbers puts text at even places and numbers at odd ones, always.
    pieces = _NUMBER.split(text.casefold())
    return tuple(_values(piece) if at % 2 else piece for at, piece in enumerate(pieces)), text


def _values(number: str) -> tuple[Fraction, ...]:
    if number.count(".") == 1:
        return (Fraction(number),)
    return tuple(Fraction(int(part)) for part in number.split("."))


def arranged(paths: Sequence[PurePath]) -> list[int]:
    """Indices of ``paths`` in the order of their names, folders as wholes.

    Names like @UTM_EAST@UTM_NORTH@... go by their time stamps or their numbers, never by position;
    names that count in hexadecimal digits by value; dates with the day or the month first, months
    by name, and hours with am or pm by time; all others naturally.

    Raises:
        ValueError: where the names of a folder do not tell the order.
    """
    keys: dict[int, tuple[NaturalKey, ...]] = {}
    for folder, members in _by_folder(paths).items():
        stems = [paths[at].stem for at in members]
        try:
            texts = _ordering(stems)
        except ValueError as error:
            where = f"{folder}: " if folder.parts else ""
            raise ValueError(f"{where}{error}; {HOW}") from None
        above = tuple(map(natural_key, folder.parts))
        for at, text in zip(members, texts, strict=True):
            name = natural_key(paths[at].stem), natural_key(paths[at].suffix)
            keys[at] = (*above, natural_key(text), *name)
    return sorted(range(len(paths)), key=keys.__getitem__)


def _by_folder(paths: Sequence[PurePath]) -> dict[PurePath, list[int]]:
    folders: dict[PurePath, list[int]] = defaultdict(list)
    for at, path in enumerate(paths):
        folders[path.parent].append(at)
    return folders


def _ordering(stems: Sequence[str]) -> list[str]:
    """A text for each name of one folder, whose natural order is that of the frames."""
    if len(stems) < 2:
        return list(stems)
    if any(map(_is_position, stems)):
        return _times(stems)
    if all(re.match(r"-[0-9]", stem) for stem in stems):
        raise ValueError(f"all names begin with '-' ({stems[0]!r}): a minus, or a dash")
    texts = _hexadecimal([stem.casefold() for stem in stems])
    texts = _dated(texts)
    if all(map(_HALF_DAY.search, texts)):
        texts = [_HALF_DAY.sub(_of_24_hours, text) for text in texts]
    return _counters(texts)


def _is_position(stem: str) -> bool:
    """Whether a name is like @UTM_EAST@UTM_NORTH@..."""
    return bool(re.match(r"@-?[0-9.]+@-?[0-9.]+@", stem))


def _times(stems: Sequence[str]) -> list[str]:
    """Time stamp and number of names @EAST@NORTH@ZONE@BAND@LAT@LON@NUMBER@...@TIME@NOTE@."""
    fields = [stem.split("@") + [""] * 14 for stem in stems]
    stamps, numbers = ([each[at].strip() for each in fields] for at in (13, 7))
    series = {found and found[0] for found in map(_last_number, numbers)}
    if all(map(_is_position, stems)):
        if all(stamps) and (len(set(stamps)) == len(stamps) or len(series - {None}) == 1):
            return [f"{stamp}@{number}" for stamp, number in zip(stamps, numbers, strict=True)]
        if len(series) == 1 and None not in series:
            return numbers
    raise ValueError(f"names like {stems[0]!r} tell where a frame is, but not all tell when")


def _hexadecimal(texts: list[str]) -> list[str]:
    """``texts``, hexadecimal numbers at their ends in decimal digits, if they count so."""
    found = [_HEXADECIMAL.fullmatch(text) for text in texts]
    heads = {each[1] for each in found if each}
    digits = [each[2] for each in found if each]
    last = {each[-1].isdecimal() for each in digits}
    if len(digits) < len(texts) or len(heads) > 1 or len(last) < 2:
        return texts  # not numbers of one kind, or the last digit is never, or always, a letter
    common = os.path.commonprefix(digits)
    word = re.match("[a-f]*", common)
    values = [int(each[len(word[0]) if word else 0 :], 16) for each in digits]
    steps = Counter(after - before for before, after in pairwise(sorted(values)))
    even = steps.total() >= _FEW and max(steps.values()) >= _COUNTED * steps.total()
    widths = set(map(len, digits))
    if not (even or (heads.pop() or "").endswith("0x") or len(widths) == 1):
        return texts
    if not even and min(widths) >= _HASH and not common:
        raise ValueError(f"names like {texts[0]!r} are hashes and tell no order")
    return list(map(str, values))


def _dated(texts: list[str]) -> list[str]:
    """``texts`` with dates as year, month, day, if all of them have one that is otherwise."""
    for pattern, (year, month, day) in _WORDY_DATES:
        found = [pattern.search(text) for text in texts]
        if all(found):
            return [
                f"{text[: at.start()]}{at[year]}-{_MONTHS.index(at[month]) + 1:02}-{at[day]:0>2}"
                f"{text[at.end() :]}"
                for text, at in zip(texts, found, strict=True)
                if at
            ]
    dates = [_DATE.search(text) for text in texts]
    if not all(dates):
        return texts
    orders = {}
    for day, month in ((1, 3), (3, 1)):
        if all(at and 1 <= int(at[month]) <= 12 and 1 <= int(at[day]) <= 31 for at in dates):
            read = [_DATE.sub(rf"\4-\g<{month}>-\g<{day}>", text) for text in texts]
            orders[tuple(sorted(range(len(read)), key=lambda at: natural_key(read[at])))] = read
    if len(orders) > 1:
        raise ValueError(f"in names like {texts[0]!r}, day and month could be either")
    return next(iter(orders.values()), texts)


def _of_24_hours(found: re.Match[str]) -> str:
    return f"{int(found[1]) % 12 + 12 * (found[3] == 'p'):02}{found[2]}"


def _counters(texts: list[str]) -> list[str]:
    """``texts``, "1.9" and "1.10" as two numbers each if the second is counted.

    Digits after a point that are cut to their length end in no 0, and those that count begin with
    none.
    """
    found = [parts[2] for text in texts for parts in _DECIMAL.finditer(text) if len(parts[2]) > 1]
    ends = any(digits.endswith("0") for digits in found)
    begins = any(digits.startswith("0") for digits in found)
    widths = {len(parts[2]) for text in texts for parts in _DECIMAL.finditer(text)}
    if len(widths) < 2 or not ends or begins:
        return texts
    return [_DECIMAL.sub(r"\1_\2", text) for text in texts]


def gaps(paths: Sequence[PurePath]) -> list[int]:
    """After which paths numbers are missing: i stands for a gap between paths i and i + 1.

    The number of a path is the last one in its name. Paths whose names are the same but for the
    number are one series; 10, 20, 30 is a series without gaps, because its usual step is 10. Where
    less than half the steps are the usual one, but for a hundredth, the numbers are no frame
    numbers but, for example, uneven times, and nothing is missing.
    """
    found = []
    for series in _steps(paths).values():
        votes = Counter(step for step in series.values() if step > 0)
        if not votes:
            continue
        usual = min(votes, key=lambda step: (-votes[step], step))
        near = sum(votes[step] for step in votes if 100 * abs(step - usual) <= usual)
        if 2 * near >= votes.total():
            found += [at for at, step in series.items() if step >= GAP * usual]
    return sorted(found)


def same_numbers(paths: Sequence[PurePath]) -> list[int]:
    """After which paths the number stays the same: img1.jpg, img1.png, or img1.jpg, img01.jpg."""
    return sorted(
        at for series in _steps(paths).values() for at, step in series.items() if step == 0
    )


def _steps(paths: Sequence[PurePath]) -> dict[tuple[PurePath, str, str], dict[int, Fraction]]:
    """Per series: index of a path -> the next path's number minus its own."""
    texts: dict[int, str] = {}
    for members in _by_folder(paths).values():
        stems = [paths[at].stem for at in members]
        try:
            texts.update(zip(members, _ordering(stems), strict=True))
        except ValueError:  # the order is a list's
            texts.update(zip(members, stems, strict=True))
    series: dict[tuple[PurePath, str, str], dict[int, Fraction]] = defaultdict(dict)
    numbers = [_last_number(texts[at]) for at in range(len(paths))]
    for at, (this, following) in enumerate(pairwise(numbers)):
        same_folder = paths[at].parent == paths[at + 1].parent
        if this is not None and following is not None and same_folder and this[0] == following[0]:
            series[paths[at].parent, *this[0]][at] = following[1] - this[1]
    return series


def _last_number(text: str) -> tuple[tuple[str, str], Fraction] | None:
    """Text around the last number of a name, and that number."""
    found = list(_NUMBER.finditer(text))
    if not found:
        return None
    last = found[-1]
    *_, value = _values(last[0])
    head = last[0].rpartition(".")[0] if last[0].count(".") > 1 else ""
    return (text[: last.start()] + head, text[last.end() :]), value
