"""Sharing of bundles: archives for a release and the Hugging Face Hub, both with checksums.

``SHA256SUMS`` lists the SHA-256 of every file of a bundle. Its own SHA-256 is the digest of the
bundle, which :func:`fetch` requires: the publisher gives it by another way than the files.
"""

from __future__ import annotations

import hashlib
import io
import re
import tarfile
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from navrl.extras import require
from navrl.files import replacing, write_text
from navrl.policies import load_bundle
from navrl.untrusted import MAX_ARRAY_BYTES, DamagedFileError, read_archive, read_bytes

SUMS = "SHA256SUMS"
HUB = "hf://"
REQUIRED = ("config.yaml", "weights.safetensors", "metrics.json", "card.md", SUMS)
OPTIONAL = ("curve.csv", "run.yaml")
_REMEDY = "get it again from its publisher"
_README = "README.md"  # shown by the hub; not part of the bundle
_HEADER = "---\nlibrary_name: navrl\ntags: [robotics, reinforcement-learning, navigation]\n---\n\n"


def write_sums(folder: Path) -> str:
    """Write ``SHA256SUMS`` of a bundle, as ``sha256sum`` does; return the bundle's digest."""
    names = sorted({*REQUIRED, *OPTIONAL} - {SUMS})
    files = {name: folder / name for name in names if (folder / name).is_file()}
    lines = [f"{_sha256(file.read_bytes())}  {name}\n" for name, file in files.items()]
    write_text(folder / SUMS, "".join(lines))
    return _sha256("".join(lines).encode())


def write_archive(folder: Path) -> Path:
    """Write a bundle as ``<folder>.tar``; equal bundles give equal archives.

    Args:
        folder: Bundle with ``SHA256SUMS``.

    Returns:
        The archive, which contains a folder of the bundle's name.
    """
    archive = folder.with_name(f"{folder.name}.tar")
    with (
        replacing(archive) as stream,
        tarfile.open(fileobj=stream, mode="w", format=tarfile.USTAR_FORMAT) as tar,
    ):
        for name in (*REQUIRED, *OPTIONAL):
            if (folder / name).is_file():
                content = (folder / name).read_bytes()
                member = tarfile.TarInfo(f"{folder.name}/{name}")
                member.size = len(content)  # time, owner and mode are the defaults
                tar.addfile(member, io.BytesIO(content))
    return archive


def upload(folder: Path, repository: str, private: bool = False) -> str:
    """Upload a bundle to the Hugging Face Hub, with its card as ``README.md``.

    The client reads the access token of ``hf auth login`` or ``HF_TOKEN``.

    Args:
        folder: Bundle with ``SHA256SUMS``.
        repository: ``OWNER/NAME``; created if it does not exist.
        private: Whether a created repository is private.

    Returns:
        ``hf://OWNER/NAME@COMMIT``.

    Raises:
        ModuleNotFoundError: If huggingface_hub is not installed.
        OSError: If the upload fails.
    """
    require("hub", "--hub", "huggingface_hub")
    from huggingface_hub import CommitOperationAdd, HfApi

    files = [folder / name for name in (*REQUIRED, *OPTIONAL) if (folder / name).is_file()]
    readme = (_HEADER + (folder / "card.md").read_text(encoding="utf-8")).encode()
    additions = [CommitOperationAdd(file.name, str(file)) for file in files]
    additions.append(CommitOperationAdd(_README, readme))
    with _hub_errors(repository):
        api = HfApi()
        api.create_repo(repository, private=private, exist_ok=True)
        commit = api.create_commit(repository, additions, commit_message=f"Publish {folder.name}")
    return f"{HUB}{repository}@{commit.oid}"


def fetch(source: str, out: str | Path, sha256: str) -> Path:
    """Get a bundle from an archive or the Hugging Face Hub and check it.

    Nothing is unpacked by name and nothing is executed: only the files of a bundle are read, with
    limited size, compared with the digest, and loaded once as an untrusted bundle.

    Args:
        source: Archive of :func:`write_archive`, or ``hf://OWNER/NAME[@REVISION]``.
        out: New folder of the bundle.
        sha256: Digest of the bundle, printed by ``navrl-publish``.

    Returns:
        ``out``.

    Raises:
        BundleError: If the bundle is damaged, or needs code outside navrl.
        DamagedFileError: If a file is missing, too many, too large, or differs from its digest.
        FileExistsError: If ``out`` exists.
        OSError: If the download fails.
        ValueError: If the digest is no SHA-256.
    """
    out = Path(out)
    if not re.fullmatch("[0-9a-f]{64}", sha256):
        raise ValueError(f"sha256={sha256}: must be the 64 hexadecimal digits of navrl-publish")
    if out.exists():
        raise FileExistsError(f"{out}: exists, must be a new folder")
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".fetch_") as place:
        names = {*REQUIRED, *OPTIONAL}
        if source.startswith(HUB):
            files = _download(source, names, Path(place) / "hub")
        else:
            files = read_archive(source, _REMEDY, names)
        _check_sums(source, files, sha256)
        folder = Path(place) / out.name
        for name, content in files.items():
            with replacing(folder / name) as stream:
                stream.write(content)
        load_bundle(folder)
        folder.rename(out)
    return out


def _check_sums(source: str, files: Mapping[str, bytes], sha256: str) -> None:
    """Compare files with ``SHA256SUMS``, and that with the digest.

    Raises:
        DamagedFileError: If a file is missing, not listed, or another one.
    """
    missing = [name for name in REQUIRED if name not in files]
    if missing:
        raise DamagedFileError(source, f"{', '.join(missing)} missing", _REMEDY)
    if _sha256(files[SUMS]) != sha256:
        reason = f"the bundle's digest is {_sha256(files[SUMS])}, must be {sha256}"
        raise DamagedFileError(source, reason, _REMEDY)
    lines = files[SUMS].decode(errors="replace").splitlines()
    listed = {name: digest for digest, _, name in (line.partition("  ") for line in lines)}
    for name, content in files.items():
        if name != SUMS and listed.get(name) != _sha256(content):
            raise DamagedFileError(source, f"{name}: must have the SHA-256 in {SUMS}", _REMEDY)


def _download(source: str, names: set[str], folder: Path) -> dict[str, bytes]:
    """Return the files of a bundle on the hub, all of one commit."""
    require("hub", source, "huggingface_hub")
    from huggingface_hub import HfApi

    repository, _, revision = source.removeprefix(HUB).partition("@")
    with _hub_errors(source):
        api = HfApi()
        info = api.model_info(repository, revision=revision or None, files_metadata=True)
        sizes = {file.rfilename: file.size or 0 for file in info.siblings or ()}
        found = sorted(names & sizes.keys())
        if sum(sizes[name] for name in found) > MAX_ARRAY_BYTES:
            raise DamagedFileError(source, f"must be at most {MAX_ARRAY_BYTES:,} bytes", _REMEDY)
        files = {
            name: api.hf_hub_download(repository, name, revision=info.sha, local_dir=folder)
            for name in found
        }
    return {name: read_bytes(file, _REMEDY) for name, file in files.items()}


@contextmanager
def _hub_errors(subject: str) -> Iterator[None]:
    """Report errors of the hub's client in one line."""
    try:
        yield
    except ValueError:
        raise
    except Exception as error:
        line = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise ConnectionError(f"{subject}: {line}") from error


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
