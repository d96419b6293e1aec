"""Several light fields at once: found in folders, named apart, and one that fails does not stop the others."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from lfref.cli.command import log, progress
from lfref.errors import FileError, InputError, LfrefError
from lfref.io import decode, explain, formats

LENSLET_SIDE = 3000
"""Pixels along the shorter side of a lenslet image, at least, if it lies in a folder without being named itself."""

NAMINGS: tuple[Callable[[Path], str], ...] = (
    lambda path: path.name if path.is_dir() else path.stem,
    lambda path: path.name,
    lambda path: f"{path.parent.name}_{path.name}",
)
"""How light fields are named; the first way by which all differ is taken."""


def found(given: Sequence[Path], pattern: str | None = None) -> dict[str, Path]:
    """Light fields by name.

    Args:
        given: Light fields, and folders of light fields. One that is given twice counts once.
        pattern: Of the views' names, if it was asked for: then each folder is one light field.

    Returns:
        Name -> path, in the order in which they were given.

    Raises:
        InputError: There is none, or two cannot be told apart by their names.
        FileError: A folder cannot be read.
    """
    paths = [each for path in given for each in ([path] if pattern is not None else _inside(path))]
    paths = list({path.resolve(): path for path in paths}.values())
    for naming in NAMINGS:
        names = [naming(path.absolute()) for path in paths]
        if paths and len(set(names)) == len(names):
            return dict(zip(names, paths, strict=True))
    raise InputError("inputs must be light fields of different names", got=", ".join(names) if paths else "none")


def _inside(path: Path) -> list[Path]:
    """A path, or the light fields in the folder that it is."""
    if not path.is_dir() or formats.is_field(path):
        return [path]
    with explain.explained(path, "read"):
        entries = sorted(child for child in path.iterdir() if formats.is_field(child))
    # Pictures that are no lenslet images are views by names that nobody knows: the reader says what to do.
    return entries if entries and all(map(_is_whole, entries)) else [path]


def _is_whole(path: Path) -> bool:
    # What is damaged is told when it is read, so that it does not stop the others.
    with suppress(FileError):
        if formats.of(path).name == "eslf":
            with decode.opened(path) as source:
                return bool(min(source.spec().width, source.spec().height) >= LENSLET_SIDE)
    return True


def place(folder: Path, name: str, path: Path, given: Sequence[Path]) -> Path:
    """Where the results of a light field go: of one that is all that was given, itself and not as a part of a folder,
    into the run folder; of others each into one of its own.

    Args:
        folder: The run folder.
        name: Of the light field.
        path: Where it was found.
        given: As of `found`.
    """
    return folder if {path.resolve()} == {each.resolve() for each in given} else folder / name


def each(paths: Mapping[str, Path], task: Callable[[str, Path], None], what: str) -> None:
    """Do something with each light field, under a progress bar; what fails is told at the end.

    Args:
        paths: Name -> path. Of a single one, an error is raised as it is.
        task: Takes name and path.
        what: What is done, for the progress bar: `refocusing`.

    Raises:
        LfrefError: Of those that failed, once all others are done.
    """
    if len(paths) == 1:
        task(*next(iter(paths.items())))
        return
    failed: dict[str, Exception] = {}
    for name, path in progress(list(paths.items()), what):
        try:
            task(name, path)
        except (LfrefError, OSError) as error:
            failed[name] = error
            log.warning("%s: %s", name, error)
    if failed:
        got = f"{len(failed)} that failed: {', '.join(failed)}"
        raise LfrefError(f"all {len(paths)} light fields must be usable", got=got, remedy="the others are done")
