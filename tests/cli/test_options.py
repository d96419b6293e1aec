"""Overrides are held against the configuration that they override."""

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from lfref.cli import composition
from lfref.errors import InputError

BASE = OmegaConf.create(
    {
        "flag": False,
        "count": 3,
        "size": 0.5,
        "name": "x",
        "nothing": None,
        "needed": "???",
        "data": {"patch": 192, "scenes": "${scene}", "seed": "${count}"},
        "scene": {"parts": [{"opacity": 1.0}], "camera": {"size": [1, 2]}},
        "net": {"_target_": "lfref.geometry.even_planes", "n": 3, "first": -1.0, "last": 1.0},
        "methods": {},
        "callbacks": {"best": {"x": 1}, "guard": None},
        "trainer": {"devices": 1, "fast_dev_run": False},
    }
)


def check(*words):
    composition.check_overrides(BASE, OverridesParser.create().parse_overrides(list(words)), ["alphas"])


@pytest.mark.parametrize(
    "word",
    [
        "flag=true", "flag=null", "count=4", "count=2.5", "size=1", "size=1e-3", "name=3", "nothing=abc", "needed=1",
        "data.patch=96", "data.scenes.camera.size=[3,4]", "scene.parts.0.opacity=0.5",
        "data.seed=7", "count=${data.patch}", "~data.patch", "trainer.devices=auto", "trainer.fast_dev_run=1",
        "+methods.mine={name:x}", "+methods.mine.name=x", "+callbacks.timer={_target_:x}", "++count=3",
        "++methods.mine={}", "count=1,2", "data={patch:3}", "net.first=2",
    ],
)  # fmt: skip
def test_what_fits_passes(word):
    check(word)


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("alpha=[1]", r"got 'alpha'; perhaps alphas"),
        ("cuont=1", r"got 'cuont'; perhaps count"),
        ("cuont=1,2", r"got 'cuont'; perhaps count"),
        ("data.ptch=1", r"got 'data.ptch'; perhaps data\.patch"),
        ("data.scenes.camera.siez=1", r"perhaps data\.scenes\.camera\.size"),
        ("scene.parts.1.opacity=1", r"got 'scene\.parts\.1\.opacity'"),
        ("scene.parts.0.opacty=1", r"perhaps scene\.parts\.0\.opacity"),
        ("nothing.below=1", r"got 'nothing\.below'"),
        ("zzz=1", r"--cfg job shows all"),
        ("+cuont=1", r"got 'cuont'; perhaps count"),
        ("++cuont=1", r"got 'cuont'; perhaps count"),
        ("+data.ptch=1", r"perhaps data\.patch"),
        ("+net.frist=1", r"perhaps net\.first"),
        ("+net._args_=[1]", r"got 'net\._args_'"),
        ("flag=yes_please", r"flag must be true or false; got 'yes_please'"),
        ("flag=1", r"flag must be true or false; got 1"),
        ("flag='true'", r"flag must be true or false; got 'true'"),
        ("count=many", r"count must be a number; got 'many'"),
        ("count=true", r"count must be a number; got True"),
        ("count=[1]", r"count must be a number; got \[1\]"),
        ("size=big", r"size must be a number; got 'big'"),
        ("data.seed=x", r"data\.seed must be a number"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_nearest(word, said):
    with pytest.raises(InputError, match=said):
        check(word)


def test_a_missing_argument_of_a_component_may_be_added():
    base = OmegaConf.create({"net": {"_target_": "lfref.geometry.even_planes", "n": 3}})
    composition.check_overrides(base, OverridesParser.create().parse_overrides(["+net.last=2"]), [])


def test_files_may_be_added_only_where_a_command_reads_them(lfref):
    assert lfref("eval", "--cfg", "job", "input=x", "+method@methods.s=shift_and_sum")[0] == 0
    status, error = lfref("eval", "--cfg", "job", "input=x", "+method@metods.s=shift_and_sum")
    assert status == 2
    assert "got 'method@metods.s'; perhaps methods" in error
