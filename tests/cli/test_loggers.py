"""Tables and pictures of an evaluation in wandb and TensorBoard, read back from their files."""

import csv
import json

import numpy as np
import OpenImageIO
import pytest
import torch
import wandb
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams import plugin_data_pb2

from lfref.cli import loggers
from lfref.io.write import write
from lfref.lightfield import LightField
from tests.cli import wandb_files
from tests.cli.conftest import TINY

WORDS = ("planes=slopes", "planes.slopes=[-1,0.5]", "+method@methods.exact=exact_fourier")


@pytest.fixture
def evaluated(lfref, tmp_path):
    """Function (*words) -> folder of an evaluation of two light fields."""
    generator = torch.Generator().manual_seed(1)
    for name in ("first", "second"):
        write(tmp_path / "fields" / name, LightField(torch.rand(3, 3, 3, 48, 56, generator=generator), name))

    def run(*words):
        status, errors = lfref("eval", f"input={tmp_path}/fields", *WORDS, *words, f"output={tmp_path}/out")
        assert status == 0, errors
        return tmp_path / "out"

    return run


def rows_of(path):
    with path.open() as file:
        return list(csv.reader(file))


def as_text(cell):
    return "" if cell is None else str(cell)


def pixels(path):
    return OpenImageIO.ImageBuf(str(path)).get_pixels("uint8")


def means(folder):
    """Mean over light fields of the MPSNR, by name, as `summary.csv` has it."""
    with (folder / "summary.csv").open() as file:
        rows = list(csv.DictReader(file))
    by_name = {}
    for row in rows:
        by_name.setdefault(f"eval/{row['method']}/{row['reference']}/mpsnr_db", []).append(float(row["mpsnr_db"]))
    return {name: sum(values) / len(values) for name, values in by_name.items()}


@pytest.mark.slow
def test_wandb_gets_the_tables_and_the_pictures_of_an_evaluation(evaluated):
    folder = evaluated("logger=wandb", "logger.wandb.offline=true", "+logger.wandb.group=evaluations")
    (file,) = wandb_files.offline_files(folder)
    run, history = wandb_files.run_of(file), wandb_files.history_of(file)
    assert (run.job_type, run.run_group, run.project) == ("eval", "evaluations", "lfref")
    assert wandb_files.config_of(file)["code"] == loggers.code()
    logged = {name: value for row in history for name, value in row.items()}
    assert {name: logged[name] for name in means(folder)} == pytest.approx(means(folder))
    for name in (loggers.SUMMARY, loggers.PLANES):
        (path,) = [row[f"{name}/path"] for row in history if f"{name}/path" in row]
        stored = json.loads((file.parent / "files" / path).read_text())
        header, *expected = rows_of(folder / f"{name.partition('/')[2]}.csv")
        assert stored["columns"] == header
        assert len(stored["data"]) == len(expected)
        for cells, texts in zip(stored["data"], expected, strict=True):
            for cell, text in zip(cells, texts, strict=True):
                assert as_text(cell) == text or cell == pytest.approx(float(text), rel=1e-9)
    shown = {name: [] for name in (loggers.SCATTER, loggers.QUALITY_BY_PLANE, loggers.COMPARISON)}
    for row in history:
        for name in shown:
            shown[name] += row.get(f"{name}/filenames", ())
    written = {
        loggers.SCATTER: ["scatter"],
        loggers.QUALITY_BY_PLANE: ["quality_by_plane"],
        loggers.COMPARISON: ["comparison/first", "comparison/second"],
    }
    for name, paths in shown.items():
        assert len(paths) == len(written[name])
        for path, own in zip(paths, written[name], strict=True):
            np.testing.assert_array_equal(pixels(file.parent / "files" / path), pixels(folder / f"{own}.png"))
    assert not (folder / "log").exists()  # the page of `lfref report` would take it for a training


@pytest.mark.slow
def test_tensorboard_gets_the_tables_as_text_and_the_pictures(evaluated):
    folder = evaluated("logger=tensorboard")
    events = EventAccumulator(str(folder / "tensorboard"), {"images": 0})
    events.Reload()
    for name, mean in means(folder).items():
        assert events.Scalars(name)[0].value == pytest.approx(mean, rel=1e-5)
    assert {loggers.SCATTER, loggers.QUALITY_BY_PLANE} <= {*events.Tags()["images"]}
    assert [event.step for event in events.Images(loggers.COMPARISON)] == [0, 1]
    (text,) = events.Tensors(f"{loggers.SUMMARY}/text_summary")[0].tensor_proto.string_val
    lines = text.decode().splitlines()
    header, *expected = rows_of(folder / "summary.csv")
    assert lines[0] == f"| {' | '.join(header)} |"
    assert len(lines) == 2 + len(expected)
    assert lines[2].startswith(f"| {' | '.join(expected[0][:3])} | {float(expected[0][3]):.4g} |")


@pytest.mark.slow
def test_tensorboard_gets_what_a_training_logs(lfref, tmp_path):
    words = (*TINY, "callbacks.progress=null", "callbacks.summary=null", "trainer.max_epochs=2")
    words += ("logger=tensorboard", "trainer.log_every_n_steps=1")
    status, errors = lfref("train", *words, "net.activation=gelu", f"output={tmp_path}/run")
    assert status == 0, errors
    events = EventAccumulator(str(tmp_path / "run" / "tensorboard"), {"images": 0})
    events.Reload()
    with (tmp_path / "run" / "log" / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = {*rows[0]} - {"step"}
    assert {"val/mpsnr", "val/mpsnr_plane/alpha_0.125", "train/lr"} <= names
    assert {*events.Tags()["scalars"]} == names
    for name in names - {"epoch"}:  # which comes with every call
        expected = [(int(row["step"]), float(row[name])) for row in rows if row[name]]
        found = [(event.step, event.value) for event in events.Scalars(name)]
        np.testing.assert_allclose(found, expected, rtol=1e-5)
    for event, written in zip(
        events.Images("val/stack"), sorted((tmp_path / "run" / "pictures").iterdir()), strict=True
    ):
        (tmp_path / "shown.png").write_bytes(event.encoded_image_string)
        # One rounds, the other cuts off.
        np.testing.assert_allclose(pixels(tmp_path / "shown.png"), pixels(written).astype(int), atol=1)
    table = events.summary_metadata["_hparams_/session_start_info"].plugin_data.content
    start = plugin_data_pb2.HParamsPluginData.FromString(table).session_start_info
    assert start.hparams["net.activation"].string_value == "gelu"
    assert start.hparams["trainer.max_epochs"].number_value == 2
    table = events.summary_metadata["_hparams_/experiment"].plugin_data.content
    experiment = plugin_data_pb2.HParamsPluginData.FromString(table).experiment
    assert [info.name.tag for info in experiment.metric_infos] == ["val/mpsnr", "val/mssim"]


def test_an_evaluation_that_cannot_be_logged_fails_before_the_work(lfref, monkeypatch, tmp_path):
    def refuse(**options):
        raise wandb.errors.UsageError("no API key")

    monkeypatch.setattr(wandb, "init", refuse)
    write(tmp_path / "field", LightField(torch.rand(3, 3, 3, 48, 56), "field"))
    words = (f"input={tmp_path}/field", *WORDS, "logger=wandb", f"output={tmp_path}/out")
    status, errors = lfref("eval", *words)
    assert status == 1
    said = "wandb must be able to start a run; got no API key; run wandb login, or set logger.wandb.offline=true"
    assert said in errors
    assert not (tmp_path / "out" / "summary.csv").exists()
