import pytest
import torch

from lfref.errors import FileError
from lfref.train.callbacks import AtomicCheckpointIO


def test_a_checkpoint_is_loadable_with_weights_only(tmp_path):
    AtomicCheckpointIO().save_checkpoint({"a": torch.arange(3), "b": [1, "x"]}, tmp_path / "c.ckpt")
    contents = torch.load(tmp_path / "c.ckpt", weights_only=True)
    assert contents["a"].tolist() == [0, 1, 2]
    assert contents["b"] == [1, "x"]


def test_an_interrupted_write_leaves_the_old_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "c.ckpt"
    AtomicCheckpointIO().save_checkpoint({"step": 1}, path)

    def dies(contents, file):
        file.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(torch, "save", dies)
    with pytest.raises(KeyboardInterrupt):
        AtomicCheckpointIO().save_checkpoint({"step": 2}, path)
    assert torch.load(path, weights_only=True) == {"step": 1}
    assert list(tmp_path.iterdir()) == [path]


def test_an_unwritable_place_is_one_clear_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError):
        AtomicCheckpointIO().save_checkpoint({}, tmp_path / "file" / "c.ckpt")
