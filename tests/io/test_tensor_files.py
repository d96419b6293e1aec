"""Files of weights: what is written is read, damaged ones are one line."""

import hashlib
import zipfile

import pytest
import torch

from lfref.errors import CheckpointError
from lfref.io import tensor_files


def test_tensors_and_words_are_read_as_they_were_written(tmp_path):
    tensors = {"a": torch.rand(3, 4).mT, "b": torch.arange(5)}
    told = {"lfref": {"format": 1, "names": ["x", "y"], "none": None}, "notes": {"gain": 1.5}}
    tensor_files.write_weights(tmp_path / "x.safetensors", tensors, told)
    found, words = tensor_files.read_weights(tmp_path / "x.safetensors")
    assert words == told
    assert found.keys() == tensors.keys()
    assert all(torch.equal(found[name], tensors[name]) for name in tensors)


@pytest.mark.parametrize("content", [b"", b"no weights at all", b"\x08\0\0\0\0\0\0\0{luck  }"])
def test_damaged_files_are_one_line(tmp_path, content):
    (tmp_path / "x.safetensors").write_bytes(content)
    with pytest.raises(CheckpointError, match="damaged"):
        tensor_files.read_weights(tmp_path / "x.safetensors")


def test_a_missing_file_is_one_line(tmp_path):
    with pytest.raises(CheckpointError, match="damaged"):
        tensor_files.read_weights(tmp_path / "x.safetensors")


@pytest.fixture
def path(tmp_path):
    (file := tmp_path / "model").write_bytes(b"graph " + tensor_files.BLANK.encode() + b" weights")
    return file


def test_the_digest_is_that_of_the_file_with_zeros_in_its_place(path):
    blank = path.read_bytes()
    tensor_files.fill_digest(path)
    assert path.read_bytes() == blank.replace(64 * b"0", hashlib.sha256(blank).hexdigest().encode())
    assert tensor_files.check_digest(path)


def test_each_changed_byte_shows(path):
    tensor_files.fill_digest(path)
    whole = path.read_bytes()
    hidden = []
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        try:
            assert not tensor_files.check_digest(path)
            hidden.append(place)
        except CheckpointError:
            pass
    # Where the mark itself is damaged the file has no digest, which its readers must notice.
    start = whole.index(tensor_files.MARK.encode())
    assert (
        set(range(start, start + len(tensor_files.MARK)))
        <= set(hidden)
        <= set(range(start, start + len(tensor_files.BLANK)))
    )


def test_files_beside_it_belong_to_it(path, tmp_path):
    (beside := tmp_path / "weights").write_bytes(b"1234")
    tensor_files.fill_digest(path, beside)
    assert tensor_files.check_digest(path, beside)
    beside.write_bytes(b"1235")
    with pytest.raises(CheckpointError, match="write it anew"):
        tensor_files.check_digest(path, beside)
    with pytest.raises(CheckpointError):
        tensor_files.check_digest(path)


def test_files_without_a_digest_are_known(tmp_path):
    for content in (b"", b"no digest", tensor_files.MARK.encode() + b"1234"):
        (tmp_path / "file").write_bytes(content)
        assert not tensor_files.check_digest(tmp_path / "file")


def test_an_archive_with_its_digest_is_still_an_archive(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("x", b"content")
    assert not tensor_files.check_archive_digest(tmp_path / "a.zip")
    tensor_files.fill_archive_digest(tmp_path / "a.zip")
    assert tensor_files.check_archive_digest(tmp_path / "a.zip")
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert archive.read("x") == b"content"


def test_members_that_share_their_bytes_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("x", bytes(5000))
        # A second entry of the directory for the same bytes.
        archive.filelist.append(archive.filelist[0])
    with pytest.raises(CheckpointError, match="plain members"):
        tensor_files.check_archive_digest(tmp_path / "a.zip")
