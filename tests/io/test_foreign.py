"""What is not read is named, with the way to something that is."""

import pytest

from lfref.errors import FileError
from lfref.io import decode, read


@pytest.mark.parametrize("suffix", [".lfp", ".lfr", ".png"])
def test_a_raw_container_names_the_tools_that_unpack_it(tmp_path, suffix, one_line):
    path = tmp_path / f"IMG_0001{suffix}"
    path.write_bytes(b"\x89LFP\r\n\x1a\n\0\0\0\x01" + bytes(40))
    with pytest.raises(FileError) as caught:
        read.read(path)
    one_line(caught.value, path, "raw container of a Lytro camera", "plenopticam", "viewpoints_*", "__Decoded.mat")


@pytest.mark.parametrize("head", [b"7z\xbc\xaf\x27\x1crest", b"\x1f\x8brest", b"Rar!\x1a\x07rest"])
def test_an_archive_is_to_be_unpacked(tmp_path, head, one_line):
    (tmp_path / "a.rar").write_bytes(head)
    with pytest.raises(FileError) as caught:
        read.read(tmp_path / "a.rar")
    one_line(caught.value, "a compressed archive", "unpack it")


def test_other_files_are_what_they_were():
    assert decode.explained(b"hello") == ("another kind of file", "convert it")
    assert decode.explained(b"") == ("an empty file", "convert it")
