"""`lfref prepare`: a set is made once, goes on where it was interrupted, and says what it is."""

import json

import pytest

from lfref.data import plane_sets

SMALL = (
    "prepare",
    "method@recipe.base=shift_and_sum",
    "workers=0",
    "recipe.scenes.camera.size=[40,40]",
    "recipe.grids=[[3,3]]",
)


def made(folder):
    (place,) = (folder / "cache" / "planes").iterdir()
    return place, sorted(place.glob(f"*{plane_sets.SUFFIX}"))


def test_a_set_is_made_and_goes_on(lfref, tmp_path):
    words = (*SMALL, f"cache_folder={tmp_path}/cache")
    assert lfref(*words, "n_fields=2", f"output={tmp_path}/one")[0] == 0
    place, paths = made(tmp_path)
    first, second = (path.read_bytes() for path in paths)
    paths[0].unlink()
    assert lfref(*words, "n_fields=3", f"output={tmp_path}/two")[0] == 0
    again, paths = made(tmp_path)
    assert again == place
    assert [path.read_bytes() for path in paths[:2]] == [first, second]
    assert len(paths) == 3
    told = json.loads((tmp_path / "two" / "set.json").read_text())
    assert told == json.loads((place / "set.json").read_text())
    assert told["key"].startswith(place.name)
    assert told["base"] == "shift_and_sum"


def test_processes_make_what_one_makes(lfref, tmp_path):
    for workers in (0, 2):
        words = (*SMALL, f"workers={workers}", f"cache_folder={tmp_path}/{workers}/cache", "n_fields=3")
        assert lfref(*words, f"output={tmp_path}/run{workers}")[0] == 0
    one, several = ([path.read_bytes() for path in made(tmp_path / str(workers))[1]] for workers in (0, 2))
    assert one == several


def test_unknown_features_are_one_line(lfref, tmp_path):
    status, errors = lfref(*SMALL, "recipe.features=[luck]", f"cache_folder={tmp_path}", f"output={tmp_path}/run")
    assert status != 0
    assert "features must be among" in errors
    assert "Traceback" not in errors


@pytest.mark.parametrize(
    ("word", "hint"), [("recipe.guides=[fine]", "recipe.features"), ("+recipe.guides=[fine]", "recipe.features")]
)
def test_the_keys_of_earlier_versions_are_answered_by_todays(lfref, word, hint):
    status, errors = lfref(*SMALL, word)
    assert status != 0
    assert f"perhaps {hint}" in errors
