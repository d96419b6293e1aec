"""A digest written into a file is that of all its bytes and of the files beside it."""

import hashlib
import zipfile

import pytest

from lfref.errors import CheckpointError
from lfref.io import digests


@pytest.fixture
def path(tmp_path):
    (file := tmp_path / "model").write_bytes(b"graph " + digests.BLANK.encode() + b" weights")
    return file


def test_the_digest_is_that_of_the_file_with_zeros_in_its_place(path):
    blank = path.read_bytes()
    digests.write(path)
    assert path.read_bytes() == blank.replace(64 * b"0", hashlib.sha256(blank).hexdigest().encode())
    assert digests.check(path)


def test_each_changed_byte_shows(path):
    digests.write(path)
    whole = path.read_bytes()
    hidden = []
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        try:
            assert not digests.check(path)
            hidden.append(place)
        except CheckpointError:
            pass
    # Where the mark itself is damaged the file has no digest, which its readers must notice.
    start = whole.index(digests.MARK.encode())
    assert set(range(start, start + len(digests.MARK))) <= set(hidden) <= set(range(start, start + len(digests.BLANK)))


def test_files_beside_it_belong_to_it(path, tmp_path):
    (beside := tmp_path / "weights").write_bytes(b"1234")
    digests.write(path, beside)
    assert digests.check(path, beside)
    beside.write_bytes(b"1235")
    with pytest.raises(CheckpointError):
        digests.check(path, beside)
    with pytest.raises(CheckpointError):
        digests.check(path)


def test_files_without_a_digest_are_known(tmp_path):
    for content in (b"", b"no digest", digests.MARK.encode() + b"1234"):
        (tmp_path / "file").write_bytes(content)
        assert not digests.check(tmp_path / "file")


def test_an_archive_with_its_digest_is_still_an_archive(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("x", b"content")
    assert not digests.check_archive(tmp_path / "a.zip")
    digests.write_to_archive(tmp_path / "a.zip")
    assert digests.check_archive(tmp_path / "a.zip")
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert archive.read("x") == b"content"


def test_members_that_share_their_bytes_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("x", bytes(5000))
        # A second entry of the directory for the same bytes.
        archive.filelist.append(archive.filelist[0])
    with pytest.raises(CheckpointError, match="plain members"):
        digests.check_archive(tmp_path / "a.zip")
