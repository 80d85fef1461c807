"""Readers of untrusted files: bounded in size, without running code.

Evaluations, recordings, logs and bundles may be damaged or malicious. Every reader of such a file
calls a function of this module, then checks the values it uses.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import sys
import tarfile
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
import yaml

MAX_TEXT_BYTES = 64 * 2**20
"""Maximum size of a text file; an ``episodes.csv`` of 10,000 episodes has about 5 MB."""
MAX_ARRAY_BYTES = 512 * 2**20
"""Maximum size of all unpacked arrays of a file; a recording of 200 steps has about 3 MB."""
_MAX_ARRAYS = 1000  # in one file; a recording has about 30
_KINDS = {dict: "an object", list: "a list"}
_CHUNK = 2**20  # bytes unpacked per read
_NPZ_ERRORS = (
    ValueError,
    TypeError,
    KeyError,
    EOFError,
    MemoryError,
    NotImplementedError,  # an unknown compression
    RuntimeError,  # an encrypted archive
    OverflowError,
    SyntaxError,  # an invalid array header
    zipfile.BadZipFile,
    zlib.error,
)


class DamagedFileError(ValueError):
    """Error for an unusable file; the message has the file, the reason and a remedy."""

    def __init__(self, file: str | Path, reason: object, remedy: str) -> None:
        super().__init__(f"{file}: {reason}; {remedy}")


def read_text(file: str | Path, remedy: str, max_bytes: int = MAX_TEXT_BYTES) -> str:
    """Read a UTF-8 file of limited size.

    Args:
        file: File to read.
        remedy: Advice to the user in the error message.
        max_bytes: Maximum size.

    Raises:
        OSError: If there is no such file, or it may not be read.
        DamagedFileError: If it is not a regular file, too large or not UTF-8 text.
    """
    try:
        return read_bytes(file, remedy, max_bytes).decode()
    except UnicodeDecodeError as error:
        raise DamagedFileError(file, f"not UTF-8 text ({error})", remedy) from error


def read_bytes(file: str | Path, remedy: str, max_bytes: int = MAX_ARRAY_BYTES) -> bytes:
    """Read a file of limited size.

    Args:
        file: File to read.
        remedy: Advice to the user in the error message.
        max_bytes: Maximum size.

    Raises:
        OSError: If there is no such file, or it may not be read.
        DamagedFileError: If it is not a regular file, or too large.
    """
    file = Path(file)
    if file.exists() and not file.is_file():  # a pipe would block
        raise DamagedFileError(file, "must be a regular file", remedy)
    with file.open("rb") as stream:
        if os.fstat(stream.fileno()).st_size > max_bytes:
            raise DamagedFileError(file, f"must have at most {max_bytes:,} bytes", remedy)
        return stream.read()


def read_json(file: str | Path, remedy: str, kind: type = dict) -> Any:
    """Read JSON whose outermost value is a ``kind``.

    Raises:
        OSError: If :func:`read_text` raises it.
        DamagedFileError: If :func:`read_text` raises it, or if it is not JSON of that type.
    """
    try:
        value = json.loads(read_text(file, remedy))
    except DamagedFileError:
        raise
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(file, f"damaged or not JSON ({error})", remedy) from error
    return _of_kind(value, kind, file, remedy)


def read_yaml(file: str | Path, remedy: str, kind: type = dict) -> Any:
    """Read plain YAML, without tags and aliases, whose outermost value is a ``kind``.

    Raises:
        OSError: If :func:`read_text` raises it.
        DamagedFileError: If :func:`read_text` raises it, or if it is not YAML of that type.
    """
    try:
        value = yaml.load(read_text(file, remedy, MAX_TEXT_BYTES // 64), Loader=_PlainLoader)
    except DamagedFileError:
        raise
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        raise DamagedFileError(file, f"damaged or not YAML ({error})", remedy) from error
    return _of_kind(value, kind, file, remedy)


def read_table(file: str | Path, remedy: str, is_log: bool = False) -> list[dict[str, str]]:
    """Read the rows of a CSV file with a header.

    A last line without line end is an error, since a killed process or a full disk causes it.

    Args:
        file: File to read.
        remedy: As in :func:`read_text`.
        is_log: Whether a running process may append rows; then such a line is ignored.

    Raises:
        OSError: If :func:`read_text` raises it.
        DamagedFileError: If :func:`read_text` raises it, or if a row does not fit the header.
    """
    text = read_text(file, remedy)
    if is_log:
        text = text[: text.rfind("\n") + 1]
    if text and not text.endswith(("\n", "\r")):
        raise DamagedFileError(file, "its last line is truncated", remedy)
    try:
        rows = list(csv.DictReader(io.StringIO(text, newline="")))
    except csv.Error as error:
        raise DamagedFileError(file, f"not CSV ({error})", remedy) from error
    for number, row in enumerate(rows, start=1):
        if None in row or None in row.values():
            raise DamagedFileError(file, f"row {number}: must have one cell per column", remedy)
    return rows


def read_arrays(
    file: str | Path, remedy: str, max_bytes: int = MAX_ARRAY_BYTES
) -> dict[str, np.ndarray]:
    """Read an ``.npz`` file without pickles and with verified checksums.

    Declared sizes are compared with the file before memory is allocated.

    Args:
        file: File to read.
        remedy: As in :func:`read_text`.
        max_bytes: Maximum size of all unpacked arrays.

    Raises:
        OSError: If there is no such file, or it may not be read.
        DamagedFileError: If it is damaged, too large or not an ``.npz`` file.
    """
    file = Path(file)
    if file.exists() and not file.is_file():
        raise DamagedFileError(file, "must be a regular file", remedy)
    try:
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            size = sum(member.file_size for member in members)
            if size > max_bytes or len(members) > _MAX_ARRAYS:
                raise ValueError(
                    f"{len(members):,} arrays of {size:,} bytes: must be at most {_MAX_ARRAYS:,} "
                    f"of {max_bytes:,} bytes"
                )
            return {m.filename.removesuffix(".npy"): _array(archive, m) for m in members}
    except _NPZ_ERRORS as error:
        raise DamagedFileError(file, f"damaged or not an .npz file ({error})", remedy) from error


def read_archive(
    file: str | Path, remedy: str, names: Collection[str], max_bytes: int = MAX_ARRAY_BYTES
) -> dict[str, bytes]:
    """Read the files ``FOLDER/NAME`` of an uncompressed tar archive into memory.

    Args:
        file: File to read.
        remedy: As in :func:`read_text`.
        names: Allowed names of files, each at most once; links, devices and other members are
            errors.
        max_bytes: Maximum size of the archive.

    Raises:
        OSError: If there is no such file, or it may not be read.
        DamagedFileError: If it is too large, not an archive, or has other members.
    """
    content = io.BytesIO(read_bytes(file, remedy, max_bytes))
    found: dict[str, bytes] = {}
    try:
        with tarfile.open(fileobj=content, mode="r:") as archive:
            for member in archive:
                folder, _, name = member.name.partition("/")
                stream = archive.extractfile(member) if member.isreg() else None
                if stream is None or member.issparse() or not folder or name not in names:
                    raise ValueError(f"{member.name!r}: must be a regular file of a bundle")
                if name in found:
                    raise ValueError(f"{member.name!r}: more than once")
                found[name] = stream.read()
                if len(found[name]) != member.size:
                    raise ValueError(f"{member.name!r}: truncated")
    except (tarfile.TarError, ValueError, EOFError, OverflowError, RecursionError) as error:
        raise DamagedFileError(file, f"damaged or not a tar archive ({error})", remedy) from error
    return found


def is_number(value: object, low: float = -math.inf, high: float = math.inf) -> TypeGuard[float]:
    """Return whether a value is a finite number in [low, high], excluding bool."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return abs(value) <= sys.float_info.max and low <= value <= high


def _of_kind(value: object, kind: type, file: str | Path, remedy: str) -> Any:
    if not isinstance(value, kind):
        reason = f"must contain {_KINDS[kind]}, found {type(value).__name__}"
        raise DamagedFileError(file, reason, remedy)
    return value


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(member) as stream:
        data = b"".join(iter(lambda: stream.read(_CHUNK), b""))  # the last read checks the checksum
    content = io.BytesIO(data)
    version = np.lib.format.read_magic(content)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"{member.filename}: unknown version {version}")
    read_header = getattr(np.lib.format, f"read_array_header_{version[0]}_0")
    shape, is_fortran, dtype = read_header(content)
    if dtype.hasobject:
        raise ValueError(f"{member.filename}: pickled objects are not supported")
    if math.prod(shape) * dtype.itemsize != len(data) - content.tell():
        raise ValueError(f"{member.filename}: shape {list(shape)} does not match its size")
    array = np.frombuffer(data, dtype, offset=content.tell()).copy()
    return array.reshape(shape, order="F" if is_fortran else "C")


class _PlainLoader(yaml.SafeLoader):
    """Safe YAML loader without aliases, which can expand to gigabytes, and double keys."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.events.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not allowed")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        """Return a mapping; a key that is given twice is an error, since one would be ignored."""
        names: set[str] = set()
        for name in (key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if name in names:
                raise yaml.YAMLError(f"{name}: must be given once")
            names.add(name)
        return super().construct_mapping(node, deep)
