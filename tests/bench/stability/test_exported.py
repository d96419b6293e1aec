"""Every format that is installed makes the network's pictures on hard cases, in any type; what is not is told."""

import pytest

from lfref.bench.stability import model_trials, trials
from lfref.bench.stability.trials import OURS
from lfref.engines.files.file_formats import FORMATS, Format


def of_format(name, monkeypatch):
    monkeypatch.setattr(model_trials, "FORMATS", {name: FORMATS[name]})
    return model_trials.exported_components()


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_files_make_the_pictures_of_their_network_and_refuse_what_is_not_finite(name, monkeypatch):
    if FORMATS[name].lacking:
        pytest.skip(f"needs {', '.join(FORMATS[name].lacking)}")
    rows = list(trials.trials(of_format(name, monkeypatch)))
    assert {(row["component"], row["precision"]) for row in rows} == {
        (f"exported network, {name}", precision) for precision in trials.PRECISIONS
    }
    for row in rows:
        # A black frame is rounding noise, amplified: no figure is right, but every one is finite.
        expected = {"one NaN": ["refused"], "black": ["holds", "inexact"]}.get(row["case"], ["holds"])
        assert row["outcome"] in expected, row


def test_a_file_that_makes_other_pictures_is_noticed(monkeypatch):
    (component,) = of_format("pt2", monkeypatch)
    file = component.formulations[OURS]
    off = component._replace(formulations={OURS: lambda views: file(views) + 0.1}, cases=component.cases[:1])
    assert {row["outcome"] for row in trials.trials([off])} == {"inexact"}


def test_what_is_not_installed_is_told_and_not_tried(monkeypatch):
    absent = Format(".absent", ("fp32",), ("json", "no_such_runtime"), None, None, "absent")
    monkeypatch.setattr(model_trials, "FORMATS", {"absent": absent})
    assert model_trials.exported_components() == []
    (row,) = model_trials.missing()
    assert (row["component"], row["outcome"], row["note"]) == (
        "exported network, absent", "missing", "no no_such_runtime installed",
    )  # fmt: skip
