"""The gate for files from outside: bounded, no code, one line that names file and remedy."""

import io
import os
import struct
import threading
import zipfile

import numpy as np
import pytest

from navrl import untrusted
from navrl.untrusted import DamagedFileError

REMEDY = "restore it"


def refused(reader, file, *words, **options):
    with pytest.raises(DamagedFileError) as error:
        reader(file, REMEDY, **options)
    line = str(error.value)
    assert line.startswith(f"{file}: ") and line.endswith(f"; {REMEDY}")
    assert all(word in line for word in words), line


def test_text_round_trips(tmp_path):
    (tmp_path / "a.json").write_text('{"b": [1, 2.5, null]}')
    (tmp_path / "a.yaml").write_text("b: [1, 2.5, null]")
    expected = {"b": [1, 2.5, None]}
    assert untrusted.read_json(tmp_path / "a.json", REMEDY) == expected
    assert untrusted.read_yaml(tmp_path / "a.yaml", REMEDY) == expected
    (tmp_path / "a.csv").write_text("a,b\n1,\n2,x\n")
    assert untrusted.read_table(tmp_path / "a.csv", REMEDY) == [
        {"a": "1", "b": ""},
        {"a": "2", "b": "x"},
    ]


@pytest.mark.parametrize(
    ("reader", "content"),
    [
        (untrusted.read_json, b""),
        (untrusted.read_json, b'{"a": 1'),
        (untrusted.read_json, b"\xff\xfe"),
        (untrusted.read_json, b"[1]"),
        (untrusted.read_json, b"[" * 100_000),
        (untrusted.read_yaml, b""),
        (untrusted.read_yaml, b"a: [1"),
        (untrusted.read_yaml, b"- 1"),
        (untrusted.read_yaml, b"a: !!python/object/apply:os.getcwd []"),
        (untrusted.read_yaml, b"a: &a [1]\nb: [*a, *a]"),
        (untrusted.read_yaml, b"[" * 5_000),
        (untrusted.read_table, b"a,b\n1,2\n3"),
        (untrusted.read_table, b"a,b\n1\n"),
        (untrusted.read_table, b"a,b\n1,2,3\n"),
        (untrusted.read_table, b"a,b\n1," + b"x" * 200_000 + b"\n"),
        (untrusted.read_arrays, b""),
        (untrusted.read_arrays, b"PK\x03\x04"),
    ],
)
def test_damaged_file_is_named_in_one_line(tmp_path, reader, content):
    file = tmp_path / "file.any"
    file.write_bytes(content)
    refused(reader, file)


def test_double_key_of_yaml_is_named(tmp_path):
    (tmp_path / "a.yaml").write_text("a: {b: 1}\nb: 2\na: 3")
    refused(untrusted.read_yaml, tmp_path / "a.yaml", "a: must be given once")


def test_a_log_may_end_in_the_middle_of_a_row(tmp_path):
    (tmp_path / "a.csv").write_text("a,b\n1,2\n3,")
    assert untrusted.read_table(tmp_path / "a.csv", REMEDY, is_log=True) == [{"a": "1", "b": "2"}]


def test_sizes_are_bounded_and_pipes_do_not_block(tmp_path):
    (tmp_path / "large.json").write_bytes(b"[" + b" " * 100 + b"]")
    refused(untrusted.read_text, tmp_path / "large.json", "at most 50 bytes", max_bytes=50)
    os.mkfifo(tmp_path / "pipe")
    for reader in (untrusted.read_text, untrusted.read_arrays):
        thread = threading.Thread(
            target=refused, args=(reader, tmp_path / "pipe", "regular file"), daemon=True
        )
        thread.start()
        thread.join(20)
        assert not thread.is_alive()


def test_arrays_round_trip(tmp_path):
    arrays = {
        "real": np.random.default_rng(0).random((3, 4), dtype=np.float32),
        "columns_first": np.asfortranarray(np.arange(6).reshape(2, 3)),
        "text": np.array("navrl-recording-1"),
        "none": np.zeros((0, 5)),
        "flags": np.array([True, False]),
    }
    for name, save in (("a.npz", np.savez), ("b.npz", np.savez_compressed)):
        save(tmp_path / name, **arrays)
        found = untrusted.read_arrays(tmp_path / name, REMEDY)
        assert found.keys() == arrays.keys()
        for key, value in arrays.items():
            assert found[key].dtype == value.dtype and np.array_equal(found[key], value)


def test_damaged_arrays_are_rejected(tmp_path):
    file = tmp_path / "a.npz"
    np.savez_compressed(file, values=np.random.default_rng(0).random(500))
    content = file.read_bytes()
    for kept in range(0, len(content), len(content) // 20):
        file.write_bytes(content[:kept])
        refused(untrusted.read_arrays, file)
    for place in range(100, len(content) - 150, len(content) // 20):  # of the packed array
        flipped = bytearray(content)
        flipped[place] ^= 1
        file.write_bytes(bytes(flipped))
        refused(untrusted.read_arrays, file)


def header(shape, dtype="<f8"):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": dtype, "fortran_order": False, "shape": shape}
    )
    return stream.getvalue()


def test_shape_larger_than_the_file_allocates_no_memory(tmp_path):
    file = tmp_path / "a.npz"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("values.npy", header((10**13,)) + b"\0" * 80)
    refused(untrusted.read_arrays, file, "values.npy", "shape")


def test_archive_that_unpacks_to_too_much_is_rejected(tmp_path):
    file = tmp_path / "a.npz"
    np.savez_compressed(file, values=np.zeros(200_000))
    assert file.stat().st_size < 5_000
    refused(untrusted.read_arrays, file, "at most", max_bytes=1_000_000)
    content = bytearray(file.read_bytes())  # an archive that lies about what it unpacks to
    for magic, offset in ((b"PK\x01\x02", 24), (b"PK\x03\x04", 22)):
        place = content.find(magic) + offset
        content[place : place + 4] = struct.pack("<I", 1_000)
    file.write_bytes(bytes(content))
    refused(untrusted.read_arrays, file, max_bytes=1_000_000)


def test_no_pickle_is_loaded(tmp_path):
    np.savez(tmp_path / "a.npz", values=np.array([{}], dtype=object))
    refused(untrusted.read_arrays, tmp_path / "a.npz", "pickled")
