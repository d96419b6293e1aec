"""Prepared captures: a folder of stored light fields, which a training opens without decoding or hashing anything.

Each field is one file, which says what it was made from; a manifest repeats this for all, so that one small file is
read at the start. A set is made field by field: what exists stays, and several machines can share the work.
"""

import csv
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lfref.captures.correct import NONE
from lfref.data import cache, stored_fields
from lfref.data.cache import Reading
from lfref.data.stored_fields import SUFFIX, StoredField
from lfref.errors import FileError, InputError, LfrefError
from lfref.io import atomic, lytro_files, view_folders

MANIFEST = "fields.json"
FORMAT = 1
"""Version of the manifest."""
TRAIN, VALIDATION, TEST = "train", "validation", "test"
SPLITS = TRAIN, VALIDATION, TEST
"""Parts of a data set: to learn from, to hold out, and to leave alone."""


@dataclass(frozen=True)
class Prepared:
    """A prepared light field, as the manifest lists it."""

    file: str
    """Name of the file in the folder of the set."""
    content: str
    """SHA-256 of the images that it was decoded from, without their names; equal for renamed copies."""
    n_bytes: int
    """Size of the file."""
    source: str
    """Name of the file or folder that it was decoded from."""
    state: str
    """Size and time of the source: another state is decoded again."""
    split: str | None
    """One of `SPLITS`; None: of no part in particular."""
    shape: Sequence[int]
    """Shape of what is stored, [V, U, C or C + 1, H, W]."""
    reading: Mapping[str, Any]
    """Options, corrections and versions with which it was decoded."""

    @property
    def name(self) -> str:
        """Name of the light field."""
        return self.file.removesuffix(SUFFIX)


def is_set(folder: Path) -> bool:
    """Whether a folder holds prepared light fields."""
    return folder.is_dir() and bool(stored_fields.paths(folder))


def is_done(path: Path, source: Path, reading: Reading, split: str | None = None) -> bool:
    """Whether a file of a set was made from this state of the source, in this way, for this part if one is given."""
    if not path.is_file():
        return False
    try:
        known = _described(path)
    except FileError:
        return False
    is_part = split is None or known.split == split
    return is_part and known.state == _state(source) and known.reading == reading.description()


def prepare(path: Path, source: Path, reading: Reading, split: str | None = None) -> None:
    """Decode a light field into a file of a set.

    Args:
        path: The file; its suffix is `stored_fields.SUFFIX`.
        source: File or folder of the light field.
        reading: How it is read.
        split: One of `SPLITS`; None: of no part in particular.

    Raises:
        LfrefError: The source cannot be read, or the disk refuses.
    """
    about = {"content": cache.content_hash(source), "source": source.name, "state": _state(source), "split": split}
    stored_fields.write(path, reading.field(source), about | {"reading": reading.description()})


def manifest(folder: Path) -> list[Prepared]:
    """The light fields of a set, by name.

    Raises:
        FileError: The folder holds none, or a file of it is damaged.
    """
    paths = stored_fields.paths(folder)
    listed = {entry.file: entry for entry in _listed(folder)}
    if not paths:
        remedy = "make it by lfref prepare set=captures"
        raise FileError(f"{folder} must hold prepared light fields", got="none", remedy=remedy)
    # Files that are not listed: a set that is still in the making, or that several machines make.
    return [listed.get(path.name) or _described(path) for path in paths]


def readable(folder: Path) -> list[Prepared]:
    """As `manifest`, without the files that cannot be described; empty for a folder that is no set yet."""
    listed, entries = {entry.file: entry for entry in _listed(folder)}, []
    for path in stored_fields.paths(folder) if folder.is_dir() else ():
        with suppress(FileError):
            entries.append(listed.get(path.name) or _described(path))
    return entries


def refuse_mixed(entries: Iterable[Prepared], reading: Reading) -> None:
    """Refuse to add light fields to a set whose others were read in another way.

    Raises:
        InputError: An option of the reader or the correction is another one.
    """
    options = _options(reading.description())
    for entry in entries:
        if other := _difference(entry, options):
            remedy = "give the option as the set has it, or another set_folder"
            raise InputError("all light fields of a set must be read in one way", got=other, remedy=remedy)


def forget_manifest(folder: Path) -> None:
    """Remove the manifest before files change: if the work is interrupted, it must not say what they were before."""
    (folder / MANIFEST).unlink(missing_ok=True)


def write_manifest(folder: Path) -> list[Prepared]:
    """List what the files of a set say about themselves; returns the list.

    Raises:
        FileError: The folder holds none, or the disk refuses.
    """
    forget_manifest(folder)
    entries = manifest(folder)
    texts = [json.dumps(entry.reading, sort_keys=True) for entry in entries]
    readings = list(dict.fromkeys(texts))  # what fields have in common is written once
    fields = [asdict(entry) | {"reading": readings.index(text)} for entry, text in zip(entries, texts, strict=True)]
    contents = {"format": FORMAT, "readings": [json.loads(text) for text in readings], "fields": fields}
    atomic.write_text(folder / MANIFEST, json.dumps(contents, indent=1) + "\n")
    return entries


def check(folder: Path) -> dict[str, str]:
    """File of each damaged light field of a set -> what is wrong with it; all tiles are read."""
    damaged = {}
    for path in stored_fields.paths(folder):
        try:
            StoredField(path, path.stem).check()
        except LfrefError as error:
            damaged[path.name] = str(error)
    return damaged


def read_splits(path: Path) -> dict[str, str]:
    """Name of a light field -> its part, from a CSV file with the columns `name` and `split`.

    Raises:
        FileError: The file cannot be read.
        InputError: A line is no name and one of `SPLITS`, or a name stands in two parts.
    """
    with atomic.file_errors(path, "read"), path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    splits: dict[str, str] = {}
    for row in rows:
        name, split = row.get("name"), row.get("split")
        if not name or split not in SPLITS or splits.setdefault(name, split) != split:
            expected = f"{path} must have the columns name and split, one of {', '.join(SPLITS)}, each name once"
            raise InputError(expected, got=", ".join(f"{key}={value}" for key, value in row.items()))
    return splits


def split_of(sources: Mapping[str, Path], splits: Mapping[str, str]) -> dict[str, str | None]:
    """Name of each light field -> its part, which a list gives to the name or to that of its file.

    Raises:
        InputError: The list names a light field that is no source.
    """
    known = {name for own, source in sources.items() for name in (own, source.name, source.stem)}
    if unknown := sorted(set(splits) - known):
        got = f"{len(unknown)} others, such as {', '.join(unknown[:3])}"
        raise InputError("a list of splits must name light fields of the input", got=got)
    return {
        own: next((splits[name] for name in (own, source.name, source.stem) if name in splits), None)
        for own, source in sources.items()
    }


def refuse_other(entries: Iterable[Prepared], reading: Reading) -> None:
    """Refuse a set whose light fields were read in another way than a training asks for.

    Raises:
        InputError: An option of the reader or the correction is another one, or the views are other ones.
    """
    views = reading.options.get("views")
    grid = views if isinstance(views, Sequence) or views is None else [views, views]
    options = _options(reading.description())
    for entry in entries:
        if other := _difference(entry, options, but=("views",)):
            remedy = "prepare a set of its own, or give the option as the set has it"
            raise InputError("a prepared set must be read as the training asks", got=other, remedy=remedy)
        if grid is not None and list(entry.shape[:2]) != list(grid):
            got = f"{entry.shape[0]}x{entry.shape[1]} in {entry.file}"
            remedy = f"prepare a set with reader.views={views}"
            raise InputError(f"the network reads {grid[0]}x{grid[1]} views", got=got, remedy=remedy)


def _options(reading: Mapping[str, Any]) -> dict[str, Any]:
    """All that a description of a reading says but versions of lfref."""
    return {**reading["reader"], "correct": reading.get("correct", NONE)}


def _difference(entry: Prepared, options: Mapping[str, Any], but: Sequence[str] = ()) -> str | None:
    """The first option, except those in `but`, by which a light field was read in another way; None: there is none."""
    theirs = _options(entry.reading)
    names = (name for name in sorted(options.keys() | theirs.keys()) if name not in but)
    name = next((name for name in names if options.get(name) != theirs.get(name)), None)
    return None if name is None else f"{name}: {theirs.get(name)} in {entry.file}, {options.get(name)} here"


def _state(source: Path) -> str:
    """Size, time and, in a folder, names of the files that a source is decoded from: names say where views stand."""
    files = view_folders.image_files(source) if source.is_dir() else [source]
    if source.suffix.lower() == lytro_files.BARE:
        with suppress(OSError):  # decoding says what is wrong
            files.append(lytro_files.frame_record(source).path)
    states = []
    for file in files:
        with atomic.file_errors(file, "read"):
            states.append(file.stat())
    newest = max((state.st_mtime_ns for state in states), default=0)
    state = f"{sum(state.st_size for state in states)} bytes, {newest}"
    if not source.is_dir():
        return state
    names = "/".join(file.name for file in files)
    return f"{state}, {hashlib.sha256(names.encode()).hexdigest()[:16]}"


def _described(path: Path) -> Prepared:
    """What the file of a prepared light field says about itself."""
    description, _ = stored_fields.describe(path)
    try:
        return Prepared(path.name, n_bytes=path.stat().st_size, shape=list(description.shape), **description.about)
    except TypeError as error:
        remedy = "make it by lfref prepare set=captures"
        raise FileError(f"{path} must be a prepared light field", got="another one", remedy=remedy) from error


def _listed(folder: Path) -> list[Prepared]:
    """The entries of the manifest; none if there is none that can be read: the files say the same."""
    try:
        contents = json.loads((folder / MANIFEST).read_text("utf-8"))
        if contents["format"] != FORMAT:
            return []
        readings = contents["readings"]
        return [Prepared(**entry | {"reading": readings[entry["reading"]]}) for entry in contents["fields"]]
    except (OSError, ValueError, TypeError, KeyError, IndexError):
        return []
