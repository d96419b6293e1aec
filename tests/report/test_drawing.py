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


def test_series_differ_by_colour_and_marker_and_all_markers_come_before_one_comes_again():
    looks = [drawing.series_style(index) for index in range(len(drawing.MARKERS) + 1)]
    assert [look["color"] for look in looks[:9]] == [*drawing.COLOURS, drawing.BLUE]
    assert looks[0]["marker"] == looks[-1]["marker"]
    assert len({(look["color"], look["marker"]) for look in looks}) == len(looks)


@pytest.mark.parametrize("values", [(34.8, 37.5, 100.0), (30.0, 50.0, 100.0)])
def test_the_folded_stretch_is_shaded_between_the_values_and_the_cap(values):
    axes = drawing.new_figure(4, 3).add_subplot()
    axes.plot(range(3), values, "o")
    drawing.fold_below_cap(axes)
    (band,) = axes.patches
    assert values[1] < band.get_y() < band.get_y() + band.get_height() < 100
