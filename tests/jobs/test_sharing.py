"""Bundles travel as an archive or over the hub; what arrives is compared with a digest."""

import hashlib
import io
import shutil
import subprocess
import tarfile

import pytest
from hub_server import COMMIT, hub

from navrl.cli.publish import main
from navrl.jobs import sharing
from navrl.policies import ZOO, load_bundle
from navrl.untrusted import DamagedFileError, read_archive


@pytest.fixture
def bundle(tmp_path):
    folder = tmp_path / "mine"
    shutil.copytree(ZOO / "paper", folder)
    return folder


@pytest.fixture
def online(monkeypatch, tmp_path):
    constants = pytest.importorskip("huggingface_hub.constants")
    with hub() as server:
        monkeypatch.setattr(constants, "ENDPOINT", server.address)
        monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
        template = server.address + "/{repo_id}/resolve/{revision}/{filename}"
        monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
        yield server


def tar(file, members):
    """Write an archive of members, (TarInfo or name, content)."""
    with tarfile.open(file, "w") as archive:
        for member, content in members:
            info = member if isinstance(member, tarfile.TarInfo) else tarfile.TarInfo(member)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    return file


def test_checksums_are_those_of_sha256sum(bundle):
    digest = sharing.write_sums(bundle)
    done = subprocess.run(
        ["sha256sum", "--check", "--quiet", sharing.SUMS], cwd=bundle, check=False
    )
    assert done.returncode == 0
    assert digest == hashlib.sha256((bundle / sharing.SUMS).read_bytes()).hexdigest()


def test_archive_is_deterministic_and_fetched_equal(bundle, tmp_path):
    digest = sharing.write_sums(bundle)
    first = sharing.write_archive(bundle).read_bytes()
    (bundle / "card.md").touch()
    archive = sharing.write_archive(bundle)
    assert archive == tmp_path / "mine.tar" and archive.read_bytes() == first
    out = sharing.fetch(str(archive), tmp_path / "new" / "theirs", digest)
    for name in sharing.REQUIRED:
        assert (out / name).read_bytes() == (bundle / name).read_bytes()
    assert not list((tmp_path / "new").glob(".fetch*"))
    with pytest.raises(FileExistsError, match="theirs: exists"):
        sharing.fetch(str(archive), out, digest)


def test_wrong_digest_and_edited_file_are_rejected(bundle, tmp_path):
    digest = sharing.write_sums(bundle)
    archive = str(sharing.write_archive(bundle))
    with pytest.raises(DamagedFileError, match=f"digest is {digest}, must be {'0' * 64}"):
        sharing.fetch(archive, tmp_path / "out", "0" * 64)
    with pytest.raises(ValueError, match="sha256=abc: must be the 64"):
        sharing.fetch(archive, tmp_path / "out", "abc")
    (bundle / "card.md").write_text("# other\n")
    archive = str(sharing.write_archive(bundle))
    with pytest.raises(DamagedFileError, match=r"card.md: must have the SHA-256 in SHA256SUMS"):
        sharing.fetch(archive, tmp_path / "out", digest)
    assert not (tmp_path / "out").exists()


def test_archive_with_unsafe_members_is_rejected(tmp_path):
    link = tarfile.TarInfo("mine/card.md")
    link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
    for members, message in (
        ([("../card.md", b"x"), ("mine/../../x", b"x")], "must be a regular file"),
        ([("/card.md", b"x")], "must be a regular file"),
        ([("mine/evil.py", b"x")], "must be a regular file"),
        ([(link, b"")], "must be a regular file"),
        ([("mine/card.md", b"x"), ("a/card.md", b"y")], "more than once"),
    ):
        with pytest.raises(DamagedFileError, match=message):
            read_archive(tar(tmp_path / "x.tar", members), "again", sharing.REQUIRED)
    (tmp_path / "y.tar").write_bytes(b"no archive")
    with pytest.raises(DamagedFileError, match="not a tar archive"):
        read_archive(tmp_path / "y.tar", "again", sharing.REQUIRED)
    whole = tar(tmp_path / "z.tar", [("mine/card.md", b"x" * 5000)]).read_bytes()
    (tmp_path / "z.tar").write_bytes(whole[:2048])
    with pytest.raises(DamagedFileError):
        read_archive(tmp_path / "z.tar", "again", sharing.REQUIRED)
    with pytest.raises(DamagedFileError):
        read_archive(tmp_path / "z.tar", "again", sharing.REQUIRED, max_bytes=100)


def test_fetched_code_outside_navrl_is_rejected(bundle, tmp_path):
    config = (bundle / "config.yaml").read_text()
    (bundle / "config.yaml").write_text(config.replace("navrl.transforms.MinPool", "os.system"))
    digest = sharing.write_sums(bundle)
    archive = str(sharing.write_archive(bundle))
    with pytest.raises(ValueError, match=r"os\.system"):
        sharing.fetch(archive, tmp_path / "out", digest)
    assert not (tmp_path / "out").exists()


def test_hub_round_trip_is_checked_by_hash(bundle, online, tmp_path):
    digest = sharing.write_sums(bundle)
    address = sharing.upload(bundle, "me/mine", private=True)
    assert address == f"hf://me/mine@{COMMIT}"
    (created,) = online.created
    assert created["name"] == "mine" and "private" in (created.get("visibility"), *created)
    assert online.files["weights.safetensors"] == (bundle / "weights.safetensors").read_bytes()
    readme = online.files["README.md"].decode()
    assert readme.startswith("---\nlibrary_name: navrl\n") and "navrl-train" in readme
    out = sharing.fetch(address, tmp_path / "theirs", digest)
    assert load_bundle(out).config == load_bundle(bundle).config
    assert not (out / "README.md").exists()
    online.files["weights.safetensors"] = online.files["weights.safetensors"][:-1] + b"\0"
    with pytest.raises(DamagedFileError, match=r"weights\.safetensors: must have the SHA-256"):
        sharing.fetch(address, tmp_path / "other", digest)
    with pytest.raises(ConnectionError, match="hf://me/none"):
        sharing.fetch("hf://me/none", tmp_path / "other", digest)


def test_large_download_is_rejected_before_it_starts(online, tmp_path, monkeypatch):
    online.files["card.md"] = b"x" * 1000
    monkeypatch.setattr(sharing, "MAX_ARRAY_BYTES", 999)
    with pytest.raises(DamagedFileError, match="at most 999 bytes"):
        sharing.fetch("hf://me/mine", tmp_path / "out", "0" * 64)


def test_command_prints_how_to_fetch_and_checks_options(bundle, tmp_path, capsys):
    extended = tmp_path / "late"
    main([str(bundle), str(extended), "--steps", "shield", "--archive"])
    line = capsys.readouterr().out.splitlines()[1].split()
    assert line[:3] == ["navrl-publish", f"{extended}.tar", "late"]
    main([line[1], str(tmp_path / "got"), *line[3:]])
    assert load_bundle(tmp_path / "got").config == load_bundle(extended).config
    for words, message in (
        (["x.tar", "out", "--fetch"], "--fetch: needs --sha256"),
        (["x.tar", "out", "--sha256", "0"], "--sha256: must be used with --fetch"),
        (["x.tar", "out", "--fetch", "--sha256", "0" * 64, "--half"], "--half: must not"),
        (["x.tar", "out", "--fetch", "--sha256", "0" * 64], "x.tar"),
    ):
        with pytest.raises(SystemExit):
            main(words)
        assert message in capsys.readouterr().err
