"""The light fields that a command is given: found, and read with as many views as its networks want."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from lfref.cli import config as configs
from lfref.cli.command import log, paths, progress
from lfref.errors import FileError, InputError, LfrefError
from lfref.functional.threads import ahead
from lfref.io import atomic, images
from lfref.io import read as reader
from lfref.lightfield import LightField
from lfref.refocuser.refocuser import Refocuser


def find(config: DictConfig) -> list[Path]:
    """The light fields that `config.input` names, those below a folder of them one by one.

    Raises:
        FileError: There is none.
    """
    return [path for entry in paths(configs.plain(config.input)) for path in reader.find(entry)]


def read(
    path: Path, config: DictConfig, refocusers: Iterable[Refocuser] = (), scratch: Path | None = None
) -> LightField:
    """Read a light field.

    Args:
        path: Where it lies.
        config: Holds `reader`; where it asks for no number of views, networks do.
        refocusers: Who will refocus it.
        scratch: A folder on a disk where its views may lie; None: in memory.

    Raises:
        FileError: It cannot be read.
        InputError: It has not the views that are wanted.
    """
    options = configs.plain(config.reader)
    field = _read(path, options if scratch is None else options | {"scratch": scratch}, refocusers)
    if missing := field.metadata.get("missing"):
        log.info("%s: %s are missing and count for nothing", field.name, missing)
    return field


def _read(path: Path, options: dict[str, Any], refocusers: Iterable[Refocuser]) -> LightField:
    network = next((refocuser for refocuser in refocusers if refocuser.grid is not None), None)
    if options["views"] is not None or network is None:
        return reader.read(path, **options)
    try:
        return reader.read(path, **options | {"views": network.grid})
    except InputError as error:
        raise InputError(f"{network.name} reads {network.grid} views", got=error) from error


# PART several
# Several light fields, streamed: found in folders, named apart, and one that fails does not stop the others.
#
# They are read, computed and written one after the other, three of them at once, so that memory is bounded.

LENSLET_SIDE = 3000
"""Pixels along the shorter side of a lenslet image, at least, if it lies in a folder without being named itself."""

NAMINGS: tuple[Callable[[Path], str], ...] = (
    lambda path: path.name if path.is_dir() else path.stem,
    lambda path: path.name,
    lambda path: f"{path.parent.name}_{path.name}",
)
"""How light fields are named; the first way by which all differ is taken."""

Step = Callable[[str, Any], Any]
"""(name, what the step before it made of a light field) -> what the next one takes; the first takes the path."""
Outcome = tuple[str, Any, Exception | None]
"""Name of a light field, what was made of it so far, and the error that ended it, if one did."""


def found(given: Sequence[Path], pattern: str | None = None) -> dict[str, Path]:
    """Light fields by name.

    Args:
        given: Light fields, folders of light fields, and patterns like `captures/*.png`. One that is given twice
            counts once.
        pattern: Of the views' names, if it was asked for: then each folder is one light field.

    Returns:
        Name -> path, in the order in which they were given; those of a folder or pattern by the numbers in their names,
        so that `frame_10` follows `frame_9`.

    Raises:
        InputError: There is none, or two cannot be told apart by their names.
        FileError: A folder cannot be read, or nothing fits a pattern.
    """
    given = [path for entry in given for path in _fitting(entry)]
    paths = [each for path in given for each in ([path] if pattern is not None else _inside(path))]
    paths = list({path.resolve(): path for path in paths}.values())
    for naming in NAMINGS:
        names = [naming(path.absolute()) for path in paths]
        if paths and len(set(names)) == len(names):
            return dict(zip(names, paths, strict=True))
    raise InputError("inputs must be light fields of different names", got=", ".join(names) if paths else "none")


def _fitting(path: Path) -> list[Path]:
    """A path, or those that fit it, where it is a pattern and no path."""
    if path.exists() or not set("*?[") & set(str(path)):
        return [path]
    parts = path.absolute().parts
    found = Path(parts[0]).glob(str(Path(*parts[1:])))
    fitting = sorted((each for each in found if not each.name.startswith(".")), key=_numbered)
    if not fitting:
        raise FileError(f"{path} must fit some file or folder", got="none", remedy="check the pattern")
    return fitting


def _numbered(path: Path) -> list[tuple[str, int]]:
    """A key by which names are sorted as people count."""
    return [(text, int(number or 0)) for text, number in re.findall(r"(\D*)(\d*)", path.name)]


def _inside(path: Path) -> list[Path]:
    """A path, or the light fields in the folder that it is."""
    if not path.is_dir() or reader.is_field(path):
        return [path]
    with atomic.file_errors(path, "read"):
        entries = sorted((child for child in path.iterdir() if reader.is_field(child)), key=_numbered)
    # Pictures that are no lenslet images are views by names that nobody knows: the reader says what to do.
    return entries if entries and all(map(_is_whole, entries)) else [path]


def _is_whole(path: Path) -> bool:
    # What is damaged is told when it is read, so that it does not stop the others.
    with suppress(FileError):
        if reader.format_of(path).name == "eslf":
            with images.open_image(path) as source:
                return bool(min(source.spec().width, source.spec().height) >= LENSLET_SIDE)
    return True


def each(paths: Mapping[str, Path], steps: Sequence[Step], what: str) -> None:
    """Do something with each light field, under a progress bar; what fails is told at the end.

    Every step works in a thread of its own, on the light field after the one that the next step works on.

    Args:
        paths: Name -> path. Of a single one, an error is raised as it is.
        steps: One after the other.
        what: What is done, for the progress bar: `refocusing`.

    Raises:
        LfrefError: Of those that failed, once all others are done.
    """
    if not paths:
        return
    if len(paths) == 1:
        ((name, made),) = paths.items()
        for step in steps:
            made = step(name, made)
        return
    outcomes: Iterable[Outcome] = ((name, path, None) for name, path in paths.items())
    for step in steps[:-1]:
        outcomes = ahead(_through(step, outcomes))
    failed = []
    for name, _, error in progress(_through(steps[-1], outcomes), what, len(paths)):
        if error is not None:
            failed.append(name)
            log.warning("%s: %s", name, error)
    if failed:
        got = f"{len(failed)} that failed: {', '.join(failed)}"
        raise LfrefError(f"all {len(paths)} light fields must be usable", got=got, remedy="the others are done")


def _through(step: Step, outcomes: Iterable[Outcome]) -> Iterator[Outcome]:
    """What a step makes of each; those that have failed are passed on."""
    for name, made, failure in outcomes:
        if failure is None:
            try:
                made = step(name, made)
            except (LfrefError, OSError) as error:
                made, failure = None, error
        yield name, made, failure
        del made
