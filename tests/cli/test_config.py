"""Every choice of the configuration composes and makes what it describes."""

import inspect

import pytest
import torch

from lfref.cli import config as configs
from lfref.cli.bench import SUITES
from lfref.cli.steps import parts_of
from lfref.errors import InputError
from lfref.io.read import read
from lfref.nets.refnet import RefNet

FOLDER = configs.directory()
GROUPS = sorted(
    path.relative_to(FOLDER).with_suffix("").as_posix()
    for path in FOLDER.glob("*/*.yaml")
    if path.parent.name not in ("experiment", "method", "suite", "aperture")
)


@pytest.mark.parametrize("choice", GROUPS)
def test_every_choice_composes_and_instantiates(composed, choice, tmp_path, monkeypatch):
    # Loggers reach out when they are built; that they can be found is what counts here.
    monkeypatch.setenv("WANDB_MODE", "disabled")
    group, _, name = choice.partition("/")
    needs = {
        "refnet": ("net.widths=[8]",),
        "refnet_small": ("net.widths=[8]",),
        "folder": (f"data.cache_folder={tmp_path}", f"data.path={tmp_path}"),
        "alphas": ("planes.alphas=[1]",),
        "slopes": ("planes.slopes=[0]",),
        "planes": ("method@data.recipe.base=shift_and_sum",),
    }
    config = composed("train", f"{group}={name}", *needs.get(name, ()))
    if group == "trainer":
        config.trainer.accelerator, config.trainer.devices = "cpu", 1
    assert configs.build(config[group]) is not None


def test_every_option_of_the_reader_can_be_set_and_stays_as_in_python(composed):
    options = inspect.signature(read).parameters
    expected = {name: option.default for name, option in options.items() if name != "path"}
    assert configs.plain(composed("refocus", "input=x").reader) == expected


@pytest.mark.parametrize("name", sorted(path.stem for path in (FOLDER / "method").glob("*.yaml")))
def test_every_method_composes_and_refocuses(composed, name):
    config = composed("refocus", f"method={name}", "input=x")
    method = configs.build(config.method)
    assert config.method.name == name
    if method.planes is not None:  # a network of fixed planes and grid, which a flat field tells nothing
        assert method(torch.rand(*method.grid, 3, 16, 16)).shape == (len(method.planes), 3, 16, 16)
        return
    stack = method(torch.full((5, 5, 3, 16, 16), 0.5), [0.5, -1.0])
    torch.testing.assert_close(stack, torch.full_like(stack, 0.5), atol=1e-3, rtol=0)


@pytest.mark.parametrize("name", SUITES)
def test_every_suite_of_bench_composes(composed, name):
    methods = parts_of(composed("bench", f"suite={name}").get("methods"))
    assert [method.name for method in methods.values()] == list(methods)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("net.activation=magic",), "activation must be one of"),  # our own error as it is
        (("+net.colour=red",), "must fit what it describes.* unexpected keyword argument 'colour'"),
        (("data=folder",), r"data\.path"),
    ],
)
def test_a_mistake_in_the_configuration_is_named(composed, words, said):
    config = composed("train", *words)
    with pytest.raises(InputError, match=said):
        configs.build(config.data if "data=folder" in words else config.net)


def test_training_reads_as_many_views_as_the_network_and_the_papers_network_is_the_default(composed):
    config = composed("train", "data=folder", "data.path=x", "net.grid=[5,3]")
    assert config.data.reader["angular_size"] == [5, 3]
    assert configs.build(composed("train").net).config == RefNet().config


def test_the_fingerprint_ignores_where_output_goes_and_nothing_else(composed):
    first, second = composed("train"), composed("train", "output=/elsewhere", "folder=/elsewhere")
    assert configs.fingerprint(first) == configs.fingerprint(second)
    assert configs.fingerprint(first) != configs.fingerprint(composed("train", "optimizer.lr=0.5"))
