"""Files of weights: what is written is read, damaged ones are one line."""

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


@pytest.mark.parametrize("content", [None, b"", b"no weights at all", b"\x08\0\0\0\0\0\0\0{luck  }"])
def test_missing_and_damaged_files_are_refused(tmp_path, content):
    if content is not None:
        (tmp_path / "x.safetensors").write_bytes(content)
    with pytest.raises(CheckpointError):
        tensor_files.read_weights(tmp_path / "x.safetensors")
