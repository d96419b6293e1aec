"""The figures show the rows: their lines and points are the tables' numbers, and labels do not collide."""

import math

import pandas as pd
import pytest
from matplotlib.text import Annotation

from lfref.errors import InputError
from lfref.report import drawing, plots

ALPHAS = [0.125, 0.5, 1.0, 2.0]


def metrics():
    train = [{"step": step, "train/loss": 1 / (1 + step), "train/l1": 0.1, "val/mpsnr": None} for step in range(5)]
    validation = [
        {"step": step, "val/mpsnr": mpsnr, "val/mssim": mssim}
        for step, mpsnr, mssim in [(1, 20.0, 0.5), (2, 33.5, 0.9), (4, 32.25, 0.8)]
    ]
    return pd.DataFrame(train + validation)


def planes(method, reference, light_field="a", lift=0.0):
    alphas = pd.Series(ALPHAS)
    names = {"light_field": light_field, "method": method, "reference": reference}
    values = {"psnr_db": 30 + alphas + lift, "ssim": 0.9 + alphas / 100}
    return pd.DataFrame({**names, "alpha": alphas, "slope": 1 - 1 / alphas, **values})


def points(line):
    return list(zip(line.get_xdata(), line.get_ydata(), strict=True))


def line_of(axes, text):
    return next(line for line in axes.get_lines() if text in line.get_label())


def test_training_lines_are_the_rows_without_empty_cells():
    loss, mpsnr, mssim = plots.training_curves(metrics()).axes
    assert points(line_of(loss, "total")) == [(step, 1 / (1 + step)) for step in range(5)]
    assert list(line_of(loss, "L1").get_ydata()) == [0.1] * 5
    assert points(mpsnr.get_lines()[0]) == [(1, 20.0), (2, 33.5), (4, 32.25)]
    assert points(mssim.get_lines()[0]) == [(1, 0.5), (2, 0.9), (4, 0.8)]
    assert loss.get_yscale() == "log"


def test_the_rise_above_the_first_validation_is_marked():
    axes = plots.training_curves(metrics()).axes[1]
    assert "first 20.00 dB, best +13.50 dB, last +12.25 dB" in axes.get_title("left")
    assert list(axes.get_lines()[1].get_ydata()) == [20.0, 20.0]
    arrow = next(child for child in axes.get_children() if isinstance(child, Annotation))
    assert (arrow.xy, arrow.xyann) == ((2, 33.5), (2, 20.0))


def test_a_run_too_short_for_training_losses_shows_those_of_validation():
    short = metrics()[5:].drop(columns=["train/loss", "train/l1"]).assign(**{"val/loss": [3.0, 2.0, 1.0]})
    loss, mpsnr, _ = plots.training_curves(short).axes
    assert [points(line) for line in loss.get_lines()] == [[(1, 3.0), (2, 2.0), (4, 1.0)]]
    assert len(mpsnr.get_lines()[0].get_xdata()) == 3


def test_planes_have_a_line_of_the_first_the_best_and_the_last_validation():
    by_plane = metrics().assign(
        **{f"val/mpsnr_plane/alpha_{alpha:g}": metrics()["val/mpsnr"] + alpha for alpha in ALPHAS}
    )
    (axes,) = plots.validation_by_plane(by_plane).axes
    for name, mpsnr in (("first, step 1", 20.0), ("best, step 2", 33.5), ("last, step 4", 32.25)):
        assert points(line_of(axes, name)) == [(alpha, mpsnr + alpha) for alpha in ALPHAS]
    assert plots.validation_by_plane(metrics()) is None


def test_a_run_without_any_loss_is_refused():
    with pytest.raises(InputError, match="must have logged a loss"):
        plots.training_curves(metrics()[["step", "val/mpsnr", "val/mssim"]])


@pytest.mark.parametrize("column", ["step", "val/mpsnr", "val/mssim"])
def test_a_missing_training_column_is_named(column):
    with pytest.raises(InputError, match=f"'{column}'"):
        plots.training_curves(metrics().drop(columns=column))


def test_quality_is_the_mean_over_light_fields():
    fields = planes("net", "shift_and_sum"), planes("net", "shift_and_sum", "b", lift=2.0)
    rows = pd.concat([*fields, planes("net", "fourier_slice", lift=-5.0)])
    psnr, ssim = plots.quality_by_plane(rows).axes
    assert points(line_of(psnr, "against shift_and_sum")) == [(alpha, 31 + alpha) for alpha in ALPHAS]
    assert points(line_of(psnr, "against fourier_slice")) == [(alpha, 25 + alpha) for alpha in ALPHAS]
    assert list(line_of(ssim, "against shift_and_sum").get_ydata()) == pytest.approx([0.9 + a / 100 for a in ALPHAS])


def test_quality_leaves_nan_out_and_shows_slopes_above():
    rows = pd.concat([planes("net", "a"), planes("net", "a")[:1].assign(psnr_db=math.nan)])
    axes = plots.quality_by_plane(rows).axes[0]
    assert points(axes.get_lines()[0]) == [(alpha, 30 + alpha) for alpha in ALPHAS]
    ticks = {tick.get_position()[0]: tick.get_text() for tick in axes.child_axes[0].get_xticklabels()}
    assert ticks == {0.125: "\N{MINUS SIGN}7.00", 0.5: "\N{MINUS SIGN}1.00", 1.0: "0.00", 2.0: "0.50"}


def test_planes_without_alphas_lie_at_their_slopes():
    rows = pd.concat([planes("net", "a").assign(alpha=None), planes("net", "b")])
    psnr, _ = plots.quality_by_plane(rows).axes
    assert points(line_of(psnr, "against a")) == [(1 - 1 / alpha, 30 + alpha) for alpha in ALPHAS]
    assert psnr.get_xlabel() == "Slope (px/view)"
    assert not psnr.child_axes


@pytest.mark.parametrize("column", ["method", "reference", "alpha", "slope", "psnr_db", "ssim"])
def test_a_missing_quality_column_is_named(column):
    with pytest.raises(InputError, match=f"'{column}'"):
        plots.quality_by_plane(planes("net", "a").drop(columns=column))


def test_six_methods_have_six_colours_and_none_of_references():
    rows = pd.concat([planes(f"net {number}", "a") for number in range(6)])
    colours = {line.get_color() for line in plots.quality_by_plane(rows).axes[0].get_lines()}
    assert len(colours) == 6
    assert not colours & {drawing.BLUE, drawing.RED}


def test_scatter_has_a_point_per_light_field_coloured_by_reference_shaped_by_method():
    rows = [
        {"method": method, "reference": reference, "mpsnr_db": 20.0 + index, "mssim": 0.8 + index / 100}
        for method in ("net", "slice")
        for reference in ("shift_and_sum", "fourier_slice")
        for index in range(3)
    ]
    lines = plots.scatter(pd.DataFrame(rows)).axes[0].get_lines()
    assert [list(line.get_xdata()) for line in lines] == [[0.8, 0.81, 0.8 + 0.02]] * 4
    assert [list(line.get_ydata()) for line in lines] == [[20.0, 21.0, 22.0]] * 4
    assert [line.get_color() for line in lines] == [drawing.BLUE, drawing.RED] * 2
    first, second, third, fourth = (line.get_marker() for line in lines)
    assert first == second != third == fourth


def test_infinite_mpsnr_is_drawn_at_the_cap():
    rows = [
        {"method": "net", "reference": "shift_and_sum", "mpsnr_db": mpsnr, "mssim": 0.9}
        for mpsnr in (25.0, 31.0, math.inf)
    ]
    axes = plots.scatter(pd.DataFrame(rows)).axes[0]
    assert list(axes.get_lines()[0].get_ydata()) == [25.0, 31.0, 100.0]
    assert axes.get_yticklabels()[-1].get_text() == "≥ 100"


@pytest.mark.parametrize(
    "make",
    [
        lambda: plots.scatter(pd.DataFrame([{"method": "_a", "reference": None, "mpsnr_db": 20.0, "mssim": 0.5}])),
        lambda: plots.quality_by_plane(planes("_$a$" * 30, "r")[:1]),
    ],
)
def test_odd_names_and_single_rows_are_drawn(make, tmp_path):
    drawing.save_figure(make(), tmp_path / "odd.png")
    assert (tmp_path / "odd.png").read_bytes().startswith(b"\x89PNG")


def classes():
    kinds = (("ideal", 0.0), ("sensor", -10.0))
    return pd.concat(
        planes(method, "truth", lift=lift).assign(**{"class": kind})
        for kind, lift in kinds
        for method in ("sum", "exact")
    )


def test_every_class_has_a_panel_with_a_line_for_every_method():
    ideal, sensor = (axes for axes in plots.psnr_by_plane(classes()).axes)
    for axes, lift in ((ideal, 0.0), (sensor, -10.0)):
        assert [points(line) for line in axes.get_lines()] == [[(alpha, 30 + alpha + lift) for alpha in ALPHAS]] * 2
    assert [axes.get_title("left") for axes in (ideal, sensor)] == ["ideal, against truth", "sensor, against truth"]


def many(n, kind="ideal"):
    return pd.concat(planes(f"method_{i}", "truth", lift=float(i)).assign(**{"class": kind}) for i in range(n))


def visible(figure):
    return [axes for axes in figure.axes if axes.get_visible()]


def test_more_than_seven_methods_are_small_multiples_in_which_all_others_are_grey():
    assert len(visible(plots.psnr_by_plane(many(7)))) == 1
    panels = visible(plots.psnr_by_plane(many(8)))
    assert [axes.get_title("left") for axes in panels] == [f"method_{i}" for i in range(8)]
    for lift, axes in enumerate(panels):
        *others, own = axes.get_lines()
        assert points(own) == [(alpha, 30 + alpha + lift) for alpha in ALPHAS]
        assert (own.get_color(), {line.get_color() for line in others}) == (drawing.BLUE, {drawing.PALE})
        assert len(others) == 8
    assert not plots.psnr_by_plane(many(8)).legends
    assert [len(visible(plots.quality_by_plane(many(n)))) for n in (7, 8)] == [2, 16]


def test_curves_judged_by_a_method_say_so_and_leave_that_method_out():
    judged = many(3, "capture").assign(reference="method_1")
    (axes,) = plots.psnr_by_plane(judged).axes
    assert axes.get_title("left") == "capture, judged by method_1 and not by the truth"
    assert axes.get_ylabel() == "PSNR against method_1 (dB)"
    assert [line.get_label() for line in axes.get_lines()] == ["method_0", "method_2"]
    psnr, ssim = plots.quality_by_plane(judged).axes
    assert (psnr.get_ylabel(), ssim.get_ylabel()) == ("PSNR against method_1 (dB)", "SSIM against method_1")
    assert [len(axes.get_lines()) for axes in (psnr, ssim)] == [2, 2]


@pytest.mark.parametrize(
    ("reference", "title", "label"),
    [
        ("fourier_slice", "judged by label sources and not by the truth", "MPSNR against fourier_slice (dB)"),
        ("rendered", "judged by the truth", "MPSNR (dB)"),
    ],
)
def test_the_scatter_says_who_judges(reference, title, label):
    rows = [{"method": name, "mpsnr_db": 20.0, "mssim": 0.5} for name in ("net", "fourier_slice")]
    axes = plots.scatter(pd.DataFrame(rows).assign(reference=reference)).axes[0]
    assert axes.get_title("left") == f"One point per light field, {title}"
    assert axes.get_ylabel() == label
    assert len(axes.get_lines()) == (1 if reference == "fourier_slice" else 2)


def test_the_scatter_says_that_truth_and_labels_judge():
    rows = [{"method": "net", "mpsnr_db": 20.0, "mssim": 0.5, "reference": name} for name in ("truth", "fourier_slice")]
    axes = plots.scatter(pd.DataFrame(rows)).axes[0]
    assert axes.get_title("left") == "One point per light field, judged by label sources and by the truth"
