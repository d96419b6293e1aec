"""Materials say what depends on the view, and refuse what is none; how they look is tested in `test_bitmaps`."""

import pytest

from lfref.errors import InputError
from lfref.simulator.materials import Emissive, Glass, Glossy, Matte, Mirror


def test_only_highlights_and_mirrored_pictures_move_with_the_view():
    assert not any(material.is_view_dependent for material in (Matte(), Emissive(), Glossy(0.0), Mirror(0.0)))
    assert all(material.is_view_dependent for material in (Glossy(), Mirror(), Glass()))


def test_reflectance_and_own_light():
    assert [material.reflectance for material in (Matte(), Mirror(0.3), Glass(0.2))] == [0, 0.3, 0.2]
    assert [material.own_gain for material in (Matte(), Glossy(), Emissive(2.0))] == [None, None, 2.0]


@pytest.mark.parametrize(
    "make",
    [
        lambda: Emissive(-1.0), lambda: Glossy(-0.1), lambda: Glossy(width=0.0), lambda: Glossy(centre=(1.0,)),
        lambda: Mirror(1.5), lambda: Glass(texture="sky"), lambda: Mirror(disparity=float("nan")),
    ],
)  # fmt: skip
def test_materials_that_are_none_are_refused(make):
    with pytest.raises(InputError):
        make()
