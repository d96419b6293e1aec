"""What a file says of itself comes back as it was said; anything else is a line."""

import copy
import json
from pathlib import Path

import pytest
import torch
from torch import nn

from lfref.engines.files import manifest
from lfref.engines.files.manifest import Manifest
from lfref.errors import CheckpointError
from tests.engines.files import cases

PATH = Path("net.onnx")
MADE = Manifest(
    "net",
    {"views": ("B", 7, 7, 3, "H", "W")},
    ("B", 2, 3, "H", "W"),
    "fp32",
    "0" * 64,
    "1.2.3",
    {"slopes": [-1.0, 0.5], "convention": "ng"},
    True,
    {"network": {"name": "refnet"}},
)


def test_what_was_said_comes_back():
    assert manifest.parse(PATH, MADE.text(), True) == MADE
    assert MADE.reads_views


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "was not written by lfref export"),
        ("{" * (manifest.LONGEST + 1), "was not written by lfref export"),
        ("[]", "must say what it holds"),
        ("{" * 1000, "must say what it holds"),
        ("{}", "must say what it holds"),
        (json.dumps({"format": 99}), "must have format 3; update lfref"),
        (json.dumps({"format": 1, "inputs": 3}), "must say what it holds"),
        (json.dumps(json.loads(MADE.text()) | {"more": 1}), "must say what it holds"),
        (json.dumps(json.loads(MADE.text()) | {"inputs": {"image": [1, 2, 3]}}), "must read views or features"),
        (json.dumps(json.loads(MADE.text()) | {"output": [1.5, 2, 3]}), "must say what it holds"),
        (json.dumps(json.loads(MADE.text()) | {"output": []}), "must say what it holds"),
    ],
)
def test_what_cannot_be_is_a_line(text, message):
    with pytest.raises(CheckpointError, match=message) as error:
        manifest.parse(PATH, text, True)
    assert "\n" not in str(error.value)


def test_free_axes_are_those_that_are_letters():
    assert cases.views().free == ({0: "B", 4: "H", 5: "W"},)
    assert cases.refiner().free == ({0: "N", 2: "H", 3: "W"},) * 3


def test_a_digest_is_of_names_shapes_and_values():
    module = nn.Sequential(nn.Conv2d(2, 3, 1), nn.ReLU())
    known = manifest.digest(module, {})
    assert manifest.digest(copy.deepcopy(module), {}) == known
    other = copy.deepcopy(module)
    with torch.no_grad():
        other[0].bias[0] += 1e-3
    assert manifest.digest(module, {"operator": "sum"}) != known
    assert manifest.digest(other, {}) != known
    assert manifest.digest(nn.Sequential(nn.Identity(), module[0]), {}) != known
    assert manifest.digest(copy.deepcopy(module).to(memory_format=torch.channels_last), {}) == known
