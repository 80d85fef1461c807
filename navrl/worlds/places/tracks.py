"""Reader of recorded pedestrians: a CSV with the columns t, id, x, y."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from navrl.untrusted import DamagedFileError, read_text
from navrl.worlds.pedestrian import Pedestrian
from navrl.worlds.places.reading import FARTHEST_M, REMEDY

COLUMNS = ("t", "id", "x", "y")
MAX_SPEED = 10.0  # m/s; a faster pedestrian is an error of the recording


def load_tracks(
    file: str | Path,
    body: str = "legs",
    half_size: tuple[float, float] = (0.2, 0.2),
    leg_radius: float = 0.07,
    smooth: bool = False,
) -> tuple[Pedestrian, ...]:
    r"""Read recorded pedestrians, one per id, in order of their ids.

    Args:
        file: CSV with the header ``t,id,x,y``: time in s, a whole number, m, m. Lines that begin
            with # are ignored. Rows may be in any order. An id with a single row is skipped.
        body: Body of each pedestrian, see :class:`navrl.worlds.Pedestrian`.
        half_size: Of the body, m.
        leg_radius: m.
        smooth: Whether to replace each second position, and those in between, by a cubic spline
            through the others: for positions that are interpolated linearly at twice the rate.

    Raises:
        OSError: If the file does not exist or is not readable.
        DamagedFileError: If it is not such a CSV; the message has the file, line, column and value.

    Example:
        >>> import pathlib, tempfile
        >>> file = pathlib.Path(tempfile.mkdtemp()) / "people.csv"
        >>> _ = file.write_text("t,id,x,y\n0.0,7,1.0,2.0\n0.5,7,1.5,2.0\n")
        >>> load_tracks(file)[0].speed
        1.0
    """
    samples: dict[int, list[tuple[float, float, float]]] = defaultdict(list)
    for number, t, person, x, y in _rows(file):
        if person != int(person):
            raise _error(file, number, "id", person, "a whole number")
        samples[int(person)].append((t, x, y))
    people = []
    for person in sorted(samples):
        track = np.array(sorted(samples[person]))
        if len(track) < 2:
            continue
        _check(file, person, track)
        times, positions = track[:, 0], track[:, 1:]
        if smooth and len(track) >= 5:
            keys = np.unique([*range(0, len(track), 2), len(track) - 1])
            positions = CubicSpline(times[keys], positions[keys])(times)
        people.append(Pedestrian.tracked(times, positions, half_size, body, leg_radius))
    if not people:
        raise DamagedFileError(file, "has no pedestrian with two rows", REMEDY)
    return tuple(people)


def window(
    people: tuple[Pedestrian, ...], start_s: float, duration_s: float
) -> tuple[Pedestrian, ...]:
    """Return the pedestrians present in a window of a recording, with times from its start.

    Args:
        people: Pedestrians with tracks.
        start_s: Start of the window, s.
        duration_s: Duration, s. One more sample before and after it is retained.
    """
    found = []
    for person in people:
        times = np.asarray(person.times) - start_s
        if times[-1] <= 0.0 or times[0] >= duration_s:
            continue
        first = max(int(np.searchsorted(times, 0.0, side="right")) - 1, 0)
        last = int(np.searchsorted(times, duration_s)) + 1
        part = slice(first, max(last, first + 2))
        kind = (person.half_size, person.body, person.leg_radius)
        found.append(Pedestrian.tracked(times[part], person.route[part], *kind))
    return tuple(found)


def _rows(file: str | Path) -> Iterator[tuple]:
    """Yield the line number and the four numbers of each row."""
    header: list[str] | None = None
    order: list[int] = []
    for number, line in enumerate(read_text(file, REMEDY).splitlines(), start=1):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        cells = [cell.strip() for cell in text.split(",")]
        if header is None:
            header = cells
            if sorted(header) != sorted(COLUMNS):
                raise _error(file, number, "header", text, f"the columns {','.join(COLUMNS)}")
            order = [header.index(name) for name in COLUMNS]
            continue
        if len(cells) != len(COLUMNS):
            raise _error(file, number, "row", text, f"{len(COLUMNS)} cells")
        yield number, *(_number(file, number, COLUMNS[k], cells[order[k]]) for k in range(4))


def _number(file: str | Path, line: int, column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not abs(value) <= (FARTHEST_M if column in "xy" else 1e9):
        raise _error(file, line, column, text, "a finite number")
    return value


def _check(file: str | Path, person: int, track: np.ndarray) -> None:
    span = np.diff(track[:, 0])
    if (span <= 0).any():
        t = track[int(np.argmin(span)), 0]
        raise DamagedFileError(file, f"id={person}: must have one row at t={t:g}", REMEDY)
    speed = np.linalg.norm(np.diff(track[:, 1:], axis=0), axis=1) / span
    if speed.max() > MAX_SPEED:
        t = track[int(speed.argmax()), 0]
        reason = f"id={person}: walks {speed.max():.1f} m/s at t={t:g}, must be <= {MAX_SPEED:g}"
        raise DamagedFileError(file, reason, REMEDY)


def _error(file: str | Path, line: int, key: str, value: object, allowed: str) -> DamagedFileError:
    return DamagedFileError(file, f"line {line}: {key}={value!r}: must be {allowed}", REMEDY)
