"""The table of formats that networks are exported to, by name."""

import importlib.util
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from lfref.engines.engine import Run
from lfref.engines.files import as_onnx, as_openvino, as_pt2
from lfref.engines.files.manifest import Graph, Manifest
from lfref.errors import CheckpointError, InputError, chosen


class Format(NamedTuple):
    """One kind of file."""

    suffix: str
    """Of its name."""
    precisions: tuple[str, ...]
    """That it can be of."""
    packages: tuple[str, ...]
    """What must be installed."""
    write: Callable[[Path, Graph, Manifest], None]
    opened: Callable[[Path], tuple[Run, Manifest]]
    engine: str
    """That it is opened by."""
    others: Mapping[str, Callable[[Path], Run]] = {}
    """Further engines that read it, by name; each is the package that it needs."""

    @property
    def lacking(self) -> list[str]:
        """What must be installed and is not."""
        return [name for name in self.packages if importlib.util.find_spec(name) is None]


FORMATS: dict[str, Format] = {
    "onnx": Format(
        ".onnx",
        tuple(as_onnx.PRECISIONS),
        as_onnx.PACKAGES,
        as_onnx.write,
        as_onnx.opened,
        "onnxruntime",
        {"openvino": as_onnx.by_openvino},
    ),
    "pt2": Format(".pt2", as_pt2.PRECISIONS, as_pt2.PACKAGES, as_pt2.write, as_pt2.opened, "pytorch"),
    "openvino": Format(
        ".xml", tuple(as_openvino.PRECISIONS), as_openvino.PACKAGES, as_openvino.write, as_openvino.opened, "openvino"
    ),
}


def of(path: Path) -> Format | None:
    """The format of a file by its suffix; None: none of these.

    Args:
        path: Of the file.
    """
    return next((each for each in FORMATS.values() if each.suffix == path.suffix.lower()), None)


def opened(path: Path) -> tuple[Run, Manifest]:
    """A file, ready to run, and what it says of itself.

    Args:
        path: With the suffix of one of `FORMATS`.

    Raises:
        CheckpointError: It cannot be read.
        InputError: A package is missing.
    """
    found = of(path)
    assert found is not None, path
    if not path.is_file():
        raise CheckpointError(f"no file at {path}", remedy="give what lfref export wrote")
    _need(found)
    return found.opened(path)


def write(path: Path, name: str, graph: Graph, manifest: Manifest) -> None:
    """Write a file.

    Args:
        path: With the suffix of the format.
        name: A key of `FORMATS`.
        graph: What it shall do.
        manifest: What it shall say of itself.

    Raises:
        InputError: There is no such format, it can't be of that precision, or a package is missing.
        FileError: The disk refuses.
    """
    found = chosen("format", name, FORMATS)
    chosen(f"precision of {name}", manifest.precision, dict.fromkeys(found.precisions))
    _need(found)
    found.write(path, graph, manifest)


def engines(path: Path) -> dict[str, Run]:
    """A file by every engine that is installed.

    Args:
        path: What `write` wrote.

    Raises:
        CheckpointError: The first of them cannot run it.
    """
    found = of(path)
    assert found is not None, path
    others = {name: run for name, run in found.others.items() if importlib.util.find_spec(name) is not None}
    return {found.engine: opened(path)[0]} | {name: run(path) for name, run in others.items()}


def _need(found: Format) -> None:
    if found.lacking:
        remedy = "pip install 'lfref[export]'"
        raise InputError("this format needs a package", got=f"no {' and no '.join(found.lacking)}", remedy=remedy)
