"""Light fields are read as they are, or with as many views as a network reads."""

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

from lfref.cli import inputs
from lfref.errors import FileError, InputError
from lfref.geometry import even_planes
from lfref.io import images
from lfref.io.read import read
from lfref.io.write import write
from lfref.lightfield import LightField
from lfref.nets.refnet import RefNet
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.operators import OperatorRefocuser
from tests.cli.test_bad_input import assert_one_line

OPERATOR = OperatorRefocuser("sum", shift_and_sum)


@pytest.fixture
def network():
    return NetworkRefocuser(RefNet(n_planes=2, grid=(3, 3), widths=(4,), stem_width=4), even_planes(2), "mine")


@pytest.fixture
def field(tmp_path):
    return write(tmp_path / "fields" / "a", LightField(torch.rand(5, 5, 3, 16, 18)))


def config(views=None, path=None):
    return OmegaConf.create({"input": None if path is None else str(path), "reader": {"views": views}})


def test_operators_read_all_views_and_networks_as_many_as_theirs(field, network):
    assert inputs.read(field, config()).grid == (5, 5)
    assert inputs.read(field, config(), [OPERATOR]).grid == (5, 5)
    assert inputs.read(field, config(), [OPERATOR, network]).grid == (3, 3)
    assert torch.equal(inputs.read(field, config(), [network]).views, read(field, views=3).views)


def test_an_option_that_concerns_other_forms_is_refused_and_their_defaults_are_not(lfref, field):
    words = ("info", field)
    assert lfref(*words, "output=run")[0] == 0  # with all of conf/reader
    said = assert_one_line(*lfref(*words, "reader.pitch=14.3"))
    assert "pitch (reader.pitch) concerns an ESLF image (PNG, TIFF, BMP ...); got a folder of views" in said
    said = assert_one_line(*lfref(*words, "reader.axes=vuhwc"))
    assert "axes (reader.axes) concerns an array" in said


def test_the_number_that_is_asked_for_counts(field, network):
    assert inputs.read(field, config(views=5), [network]).grid == (5, 5)


def test_a_field_too_small_for_a_network_names_the_network(tmp_path, network):
    small = write(tmp_path / "small", LightField(torch.rand(2, 2, 3, 16, 18)))
    with pytest.raises(InputError, match=r"mine reads \(3, 3\) views; got views to keep must be among the 2"):
        inputs.read(small, config(), [network])


def test_the_light_fields_below_a_folder_are_found(field):
    assert inputs.find(config(path=field)) == [field]
    assert inputs.find(config(path=field.parent)) == [field]
    with pytest.raises(FileError, match="must hold light fields"):
        inputs.find(config(path=field.parent / "none"))


def test_missing_views_are_told(tmp_path, caplog):
    for row, column in ((0, 0), (0, 1), (1, 0)):
        images.write_image(tmp_path / f"a_{row}_{column}.png", np.zeros((4, 5, 3), np.uint8))
    options = OmegaConf.create({"reader": {"views": None, "holes": True}})
    with caplog.at_level("INFO"):
        assert inputs.read(tmp_path, options).grid == (2, 2)
    assert "1 of 4 views are missing" in caplog.text
