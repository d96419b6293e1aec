"""`lfref bench` leaves tables and pictures, evaluates by the truth where it is known, and names its reference else."""

import re

import numpy as np
import pytest
from matplotlib.image import imread

from lfref.bench.stability import catalogue
from lfref.cli import config as configs
from lfref.functional.psnr import psnr
from lfref.io.read import read, read_stack
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.report import answers
from lfref.report.tables import read_table


def without(group, kind, *kept):
    """Overrides that leave out the methods of a group but these."""
    text = "".join((configs.directory() / "suite" / f"{name}.yaml").read_text() for name in {group, "operators"})
    names = re.findall(rf"{kind}\.(\w+):", text)
    return [f"~{kind}.{name}" for name in names if name not in kept and (group, name) != ("front", "tilt_shift")]


QUICK = ("repeats=1", "warmup=0", "device=cpu")
FEW = (*without("front", "methods", "shift_and_sum", "exact_fourier"), "aliased=false", "wide=false")
SCENES = ("test_scenes=[stripes,graded]", "scene.camera.size=[32,40]", "planes.alphas=[0.25,0.8,1]")


@pytest.fixture
def run(lfref, tmp_path):
    """Function (*words) -> folder of a run."""

    def make(*words):
        status, errors = lfref("bench", *QUICK, *words, f"output={tmp_path}/run")
        assert status == 0, errors
        return tmp_path / "run"

    return make


def test_scenes_are_evaluated_by_truth_ideal_aliased_with_a_sensor_and_corrected(run):
    words = [word for word in FEW if word not in ("~methods.mean_of_views", "aliased=false")]
    folder = run(*words, *SCENES, "margin=4")
    table, scenes, planes = (read_table(folder / f"{name}.csv") for name in ("bench", "scenes", "evaluation"))
    methods, kinds = ("shift_and_sum", "exact_fourier", "mean_of_views"), {"ideal", "aliased", "sensor", "corrected"}
    assert {*table["method"]} == {"numpy_fft_4d", *methods}
    assert {*zip(scenes["class"], scenes["scene"], strict=True)} == {
        *((kind, scene) for kind in ("ideal", "aliased") for scene in ("stripes", "graded")),
        *((kind, "graded") for kind in ("sensor", "corrected")),
    }
    assert {*table["class"].dropna()} == kinds
    rows = table.set_index(["method", "class"])
    for method in methods:
        own = planes[(planes["method"] == method) & (planes["class"] == "ideal") & (planes["slope"] != 0)]
        assert rows.loc[method, "ideal"]["nonzero_psnr_db"] == pytest.approx(own["psnr_db"].clip(upper=70).mean())
    exact = rows.loc["exact_fourier"]
    assert exact.loc["aliased", "worst_plane_db"] < exact.loc["ideal", "worst_plane_db"]
    assert all(imread(folder / f"{name}.png").std() > 0.05 for name in ("accuracy_time", "by_plane"))
    # The log has the answer, and crops show where ours is worst.
    answer = answers.of_bench(table, scenes)
    assert answer.sentence in (folder / "bench.log").read_text()
    _, _, ours, truth, _ = (imread(file).astype(float) for file in answers.read_crops(folder, answer).values())
    own = planes[(planes["class"] == answer.kind) & (planes["scene"] == answer.worst)]
    worst = own[own["method"] == answer.ours]["psnr_db"].min()
    assert np.square(ours - truth).mean() ** 0.5 == pytest.approx(10 ** (-worst / 20), abs=0.004)


@pytest.fixture
def simulated(lfref, tmp_path):
    """A folder of a light field of 5x5 views, and its truth."""
    words = ("scene.camera.size=[64,72]", "scene.camera.grid=[5,5]", "planes.alphas=[0.5,1]")
    assert lfref("simulate", f"output={tmp_path}/scenes", "n_fields=1", *words)[0] == 0
    return tmp_path / "scenes"


@pytest.mark.parametrize(
    ("words", "kind", "reference"),
    [
        ((), "capture", "exact_fourier"),
        (("angular_stride=2",), "hold_out", "dense_integral"),
        (("truth",), "given", "truth"),
    ],
)
def test_captures_are_evaluated_by_the_best_reference_there_is(run, simulated, words, kind, reference):
    words = [f"truth={simulated}" if word == "truth" else word for word in words]
    folder = run(*FEW, f"input={simulated}", "planes.alphas=[0.5,1]", "margin=8", "correct=none", *words)
    table = read_table(folder / "evaluation.csv")
    assert {*zip(table["class"], table["reference"], strict=True)} == {(kind, reference)}
    assert ("no truth is known" in (folder / "bench.log").read_text()) is (kind == "capture")
    assert kind == "given" or (table["psnr_db"] > 30).all()
    if kind == "given":
        (path,) = simulated.glob("*_truth.exr")
        truth, planes = read_stack(path)
        stack = shift_and_sum(read(simulated / table["scene"][0]).views, planes.slopes)
        expected = psnr(*(each[..., 8:-8, 8:-8].double() for each in (stack, truth)))
        own = table[table["method"] == "shift_and_sum"].set_index("slope")["psnr_db"]
        assert own[planes.slopes.tolist()].tolist() == pytest.approx(expected.tolist(), abs=0.01)


def test_one_scene_tells_all_causes(run):
    words = without("causes", "remedies", "shift_and_sum_cubic", "exact_fourier_fill")
    folder = run("suite=causes", "test_scenes=[discs]", "alphas=[0.5,2]", "grids=[5]", *words)
    names = ("causes", "causes_by_plane", "causes_by_scene")
    tables = [read_table(folder / f"{name}.csv") for name in names]
    assert [len(rows) for rows in tables] == [14 * 3, 14 * 3 * 2, 14 * 3 * 2]
    costs = tables[0].groupby("cause")["cost_db"].first()
    assert costs["points"] > costs["pixels"] > 0
    assert costs["vignetting"] > 10
    assert imread(folder / "causes.png").std() > 0.05


def test_time_and_growth_of_operators_are_measured(run):
    kept = ("shift_and_sum", "fourier_slice", "shift_and_sum_fill")
    sizes = ("scales.sides=[0.5,1]", "scales.views=[1,3]", "scales.planes=[1,2]", "scene.camera.size=[48,64]")
    folder = run("suite=operators", "scale_repeats=1", *sizes, *without("operators", "methods", *kept))
    rows = read_table(folder / "operators.csv")
    assert sorted(rows["method"]) == sorted(["numpy_fft_4d", *kept])
    assert (rows["median_s"] > 0).all()
    exponents = read_table(folder / "exponents.csv")
    measured = {*zip(exponents["method"], exponents["axis"], strict=True)}
    assert measured == {(name, axis) for name in kept for axis in ("pixels", "views", "planes")}


def test_trials_of_hard_cases_are_written_and_shown(run):
    folder = run("suite=stability", "parts=[losses]")
    rows = read_table(folder / "stability.csv")
    assert {*rows["case"]} == {case.name for case in catalogue.IMAGES}
    assert {*rows[rows["formulation"] == "lfref"]["outcome"]} == {"holds"}
    assert imread(folder / "stability.png").std() > 0.05  # a blank figure has one colour
    assert "Hard cases" in (folder / "index.html").read_text()
