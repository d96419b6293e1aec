"""What a module is made of: found through every way of importing, and nothing of other packages."""

from lfref.functional import jit


def package(folder, **texts):
    (folder / "house").mkdir()
    for name, text in {"__init__": "", **texts}.items():
        (folder / "house" / f"{name}.py").write_text(text)
    return folder / "house"


def test_every_kind_of_import_is_found(tmp_path):
    house = package(
        tmp_path,
        a="import house.b\nfrom house import c as other, nothing\nfrom house.d import (\n    X,  # why\n    Y,\n)\n"
        "def f():\n    from house import e\nimport os\nfrom elsewhere import g\ntext = 'from house import g'\n",
        **dict.fromkeys("bcdeg", ""),
    )
    names = [file.stem for file in jit.imported(house / "a.py", house)]
    assert sorted(names) == ["__init__", "b", "c", "d", "e"]


def test_the_digest_follows_imports_of_imports_and_circles(tmp_path):
    house = package(tmp_path, a="from house import b", b="from house import c", c="from house import a", d="")
    before = jit.digest(house / "a.py", house)
    for name, changes in (("d", False), ("c", True)):
        (house / f"{name}.py").write_text("from house import a  # changed")
        jit.digest.cache_clear()
        assert (jit.digest(house / "a.py", house) != before) is changes
