"""Atomic writes of files, with errors that name the file."""

from __future__ import annotations

import csv
import errno
import io
import json
import os
import re
import secrets
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

_DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
_FORMULA_STARTS = tuple("=+-@\t\n")  # OWASP, CSV injection


@contextmanager
def replacing(file: str | Path) -> Iterator[BinaryIO]:
    """Open a binary stream whose content replaces ``file`` when complete and on disk.

    The content is written to a hidden file in the same folder, synchronized, and renamed. On an
    exception the hidden file is removed and ``file`` is not changed.

    Args:
        file: File to write; missing folders are created. An existing non-regular file, such as
            ``/dev/stdout``, is written in place.

    Raises:
        OSError: If writing fails, with ``file`` in the message; also if a library replaced the
            error by its own.
    """
    with replacing_path(file, ".tmp") as fresh:
        raw = _RememberingFile(fresh, "wb")
        stream = io.BufferedWriter(raw)
        try:
            yield stream
            stream.flush()
            _synchronize(raw.fileno())
        except Exception as error:
            if raw.failure is not None:
                raise raw.failure from error
            raise
        finally:
            with suppress(OSError):  # of an earlier failed flush
                stream.close()


@contextmanager
def replacing_path(file: str | Path, suffix: str | None = None) -> Iterator[Path]:
    """Yield the path of a new file that replaces ``file`` if the block succeeds.

    Use it for programs and libraries that write by name, and :func:`replacing` otherwise.

    Args:
        file: File to write; missing folders are created.
        suffix: Suffix of the new file, which may determine its format; that of ``file`` if
            ``None``.

    Raises:
        OSError: If writing fails; the message names ``file``.
    """
    shown, file = file, Path(os.path.realpath(file))  # follow links
    suffix = file.suffix if suffix is None else suffix
    fresh = file.with_name(f".{file.stem}.{secrets.token_hex(4)}{suffix}")
    try:
        if file.exists() and not file.is_file():
            yield file
            return
        file.parent.mkdir(parents=True, exist_ok=True)
        yield fresh
        os.replace(fresh, file)
        _synchronize_folder(file.parent)
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(fresh)):
            raise
        raise OSError(error.errno, error.strerror, str(shown)) from error
    finally:
        with suppress(OSError):
            fresh.unlink()


def write_text(file: str | Path, text: str) -> Path:
    """Write UTF-8 text atomically and return its path."""
    with replacing(file) as stream:
        stream.write(text.encode())
    return Path(file)


def write_json(file: str | Path, value: object, **options: Any) -> Path:
    """Write JSON with a final newline atomically; ``options`` are those of :func:`json.dumps`."""
    return write_text(file, json.dumps(value, **options) + "\n")


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> str:
    """Return CSV with a header, safe against formulas in spreadsheets.

    Args:
        columns: Names of the columns, in order.
        rows: Cells by column. Text that begins like a formula is prefixed by an apostrophe, as in
            spreadsheets; numbers, also as text, are not changed.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(_safe_cell, columns))
    writer.writerows([_safe_cell(row.get(name)) for name in columns] for row in rows)
    return text.getvalue()


def markdown_text(text: str, code: bool = False) -> str:
    """Return text as one line of Markdown without markup, suitable for tables.

    Args:
        text: Any text.
        code: Whether it is used between backticks, where only backticks and bars are special.
    """
    line = " ".join(text.split())
    if code:
        return line.replace("`", "'").replace("|", "\\|")
    escaped = re.sub(r"([\\`*\[\]|])", r"\\\1", line)
    return escaped.replace("&", "&amp;").replace("<", "&lt;")


def explain_os_error(error: OSError) -> str:
    """Return one line that names the file and, for a full disk, what to do."""
    if error.errno in _DISK_FULL:
        place = f"{error.filename}: " if error.filename else ""
        return f"{place}no space left on the disk; free some and run the same command again"
    if error.errno is not None and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error)


class _RememberingFile(io.FileIO):
    """File that stores its error, since torch.save reports a full disk as its own bug."""

    failure: OSError | None = None

    def write(self, data: Any) -> int | None:
        try:
            return super().write(data)
        except OSError as error:
            self.failure = error
            raise


def _safe_cell(value: object) -> object:
    if not isinstance(value, str):
        return value
    value = value.replace("\r", "\n")  # not quoted by the writer, but ends rows in spreadsheets
    if not value.startswith(_FORMULA_STARTS):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


def _synchronize(descriptor: int) -> None:
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # a pipe or a terminal
            raise


def _synchronize_folder(folder: Path) -> None:
    """Synchronize a rename to disk, if the system supports it for folders."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
