import pytest

from lfref.errors import FileError
from lfref.report import drawing


def test_a_figure_that_cannot_be_saved_leaves_the_old_file(tmp_path):
    path = tmp_path / "plot.png"
    drawing.save_figure(drawing.new_figure(1, 1), path)
    old = path.read_bytes()
    broken = drawing.new_figure(1, 1)
    broken.text(0.5, 0.5, r"$\frac$")
    with pytest.raises(ValueError, match="frac"):
        drawing.save_figure(broken, path)
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [old]
    with pytest.raises(FileError):
        drawing.save_figure(drawing.new_figure(1, 1), tmp_path)


def test_capped_rows_keep_everything_but_the_excess():
    rows = [{"method": "a", "psnr_db": float("inf")}, {"method": "b", "psnr_db": 31.0}]
    assert drawing.capped(rows, "psnr_db") == [{"method": "a", "psnr_db": 100.0}, {"method": "b", "psnr_db": 31.0}]
