"""`lfref view`: a page for each light field, or one line."""

import base64
import json
import re
import urllib.parse

import numpy as np
import pytest

from lfref.geometry import FocalPlanes
from lfref.io import images, write
from tests.io import lytro_drawing
from tests.viewer import cases

WORDS = (
    "view",
    "slopes=[-0.5,0,1]",
    "method@methods.first=shift_and_sum",
    "methods.first.operator.interpolation=cubic",
    "method@methods.second=shift_and_sum",
    "correct=none",
)


@pytest.fixture
def field(tmp_path):
    return write.write(tmp_path / "field", cases.scene()[0])


def held(folder):
    """The page, and its content with pictures in place of their addresses in the page."""
    text = (folder / "index.html").read_text()
    elements = dict(re.findall(r'id="(text_\d+)">(.*?)</script>', text))
    elements["first"] = re.search(r'id="first" src="(.*?)"', text).group(1)
    content = re.search(r'id="content">(.*?)</script>', text).group(1)
    return text, json.loads(re.sub(r'"#(\w+)"', lambda address: json.dumps(elements[address.group(1)]), content))


def test_a_light_field_becomes_a_page(lfref, field, tmp_path):
    status, errors = lfref(*WORDS, field, f"output={tmp_path}/run", "title=A wall")
    assert status == 0, errors
    text, made = held(tmp_path / "run")
    assert "<title>A wall</title>" in text
    assert [method["name"] for method in made["methods"]] == ["shift_and_sum", "shift_and_sum (2)"]
    assert made["slopes"] == [-0.5, 0, 1]
    assert made["size"] == [96, 128]
    assert not re.search(r"(src|href)=.?https?:", text)


def test_the_truth_is_shown_beside_the_methods(lfref, field, tmp_path):
    stack = 0.5 * cases.methods()["linear"].stack[:2]
    write.write_stack(tmp_path / "truth.exr", stack, FocalPlanes([1.0, -1.0]))
    status, errors = lfref("view", field, f"truth={tmp_path}/truth.exr", WORDS[2], f"output={tmp_path}/run")
    assert status == 0, errors
    _, made = held(tmp_path / "run")
    assert made["slopes"] == [-1, 1]
    assert made["methods"][-1]["name"] == "truth"


def test_a_gallery_holds_what_could_be_read(lfref, field, tmp_path):
    (tmp_path / "broken.png").write_bytes(b"no picture")
    other = write.write(tmp_path / "b & <c>", cases.scene()[0])
    status, _ = lfref(*WORDS, field, other, str(tmp_path / "broken.png"), f"output={tmp_path}/run")
    assert status == 1
    gallery = (tmp_path / "run" / "index.html").read_text()
    places = [urllib.parse.unquote(place) for place in re.findall(r'href="(.*?)"', gallery)]
    assert len(places) == 2
    assert all((tmp_path / "run" / place).is_file() for place in places)
    _, made = held(tmp_path / "run" / "field")
    assert made["methods"][0]["planes"][made["start"]["plane"]] in gallery
    assert "<c>" not in gallery


def test_a_file_for_sharing_of_a_lytro_camera_becomes_a_page_of_its_pictures(lfref, tmp_path):
    depth = np.array([[-5.5, 0.25], [0.25, 4.0]], np.float32)
    path = lytro_drawing.write_focal_stack(tmp_path / "IMG_0001-stk.lfp", (4.0, 0.25, -5.5), depth)
    status, errors = lfref("view", path, f"output={tmp_path}/run")
    assert status == 0, errors
    _, made = held(tmp_path / "run")
    assert made["slopes"] == [-5.5, 0.25, 4.0]
    assert made["titles"] == ["lambda -5.5", "lambda 0.25", "lambda 4"]
    assert (made["quantity"], made["depth"]["low"], made["depth"]["high"]) == ("lambda", -5.5, 4.0)
    for plane, number in zip(made["methods"][0]["planes"], (2, 1, 0), strict=True):
        (tmp_path / "plane").write_bytes(base64.b64decode(plane.partition(",")[2]))
        picture = images.read_image(tmp_path / "plane")
        assert abs(picture.astype(int) - lytro_drawing.stack_picture(number)).max() < 16
    steps = np.frombuffer(base64.b64decode(made["depth"]["disparity"]), "<u2").reshape(48, 64)
    np.testing.assert_allclose(steps[[0, 0, -1], [0, -1, -1]] / 65535 * 9.5 - 5.5, [-5.5, 0.25, 4.0], atol=1e-3)
