"""The table of file formats to which networks are exported, by name."""

import importlib.util
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from lfref.engines import by_openvino
from lfref.engines.engine import INT8, NetworkFunction
from lfref.engines.files import as_onnx, as_openvino, as_pt2
from lfref.engines.files.manifest import Graph, Manifest
from lfref.errors import CheckpointError, InputError, chosen


class NetworkFormat(NamedTuple):
    """A file format of networks."""

    suffix: str
    """Suffix of the file name, with its dot."""
    precisions: tuple[str, ...]
    """Precisions that it can hold."""
    packages: tuple[str, ...]
    """Packages that must be installed."""
    write: Callable[[Path, Graph, Manifest], None]
    read: Callable[[Path], tuple[NetworkFunction, Manifest]]
    engine: str
    """The engine that runs it."""
    others: Mapping[str, Callable[[Path], NetworkFunction]] = {}
    """Further engines that run it, by the name of the package that each needs."""

    @property
    def lacking(self) -> list[str]:
        """Packages that are not installed."""
        return [name for name in self.packages if importlib.util.find_spec(name) is None]


FORMATS: dict[str, NetworkFormat] = {
    "onnx": NetworkFormat(
        ".onnx", as_onnx.PRECISIONS, as_onnx.PACKAGES, as_onnx.write, as_onnx.read, "onnxruntime",
        {"openvino": as_onnx.run_by_openvino},
    ),
    "pt2": NetworkFormat(".pt2", as_pt2.PRECISIONS, as_pt2.PACKAGES, as_pt2.write, as_pt2.read, "pytorch"),
    "openvino": NetworkFormat(
        ".xml", as_openvino.PRECISIONS, as_openvino.PACKAGES, as_openvino.write, as_openvino.read, "openvino"
    ),
}  # fmt: skip


def format_of(path: Path) -> NetworkFormat | None:
    """The format to which a file's suffix belongs; None if no format has this suffix."""
    return next((entry for entry in FORMATS.values() if entry.suffix == path.suffix.lower()), None)


def read(path: Path) -> tuple[NetworkFunction, Manifest]:
    """A file with the suffix of a format, ready to run, and its manifest; CheckpointError for other files."""
    file_format = format_of(path)
    assert file_format is not None, path
    if not path.is_file():
        raise CheckpointError(f"no file at {path}", remedy="give what lfref export wrote")
    check_packages(file_format)
    return file_format.read(path)


def write(path: Path, name: str, graph: Graph, manifest: Manifest) -> None:
    """Write a file in the format `name`, in the precision of the manifest; InputError if either does not exist."""
    check_available(name, manifest.precision)
    FORMATS[name].write(path, graph, manifest)


def engines(path: Path) -> dict[str, NetworkFunction]:
    """A file that `write` wrote, ready to run by every installed engine."""
    file_format = format_of(path)
    assert file_format is not None, path
    others = {name: run for name, run in file_format.others.items() if importlib.util.find_spec(name) is not None}
    return {file_format.engine: read(path)[0]} | {name: run(path) for name, run in others.items()}


def check_available(name: str, precision: str) -> None:
    """Raise InputError if there is no such format, if it has no such precision, or if a package is missing."""
    file_format = chosen("format", name, FORMATS)
    chosen(f"precision of {name}", precision, dict.fromkeys(file_format.precisions))
    check_packages(
        file_format, by_openvino.PREPARATIONS[INT8].packages if (name, precision) == ("openvino", INT8) else ()
    )


def check_packages(file_format: NetworkFormat, further: tuple[str, ...] = ()) -> None:
    """Raise InputError if a package of a format, or one of `further`, is not installed."""
    packages = dict.fromkeys((*file_format.packages, *further))
    if absent := [name for name in packages if importlib.util.find_spec(name) is None]:
        remedy = "pip install 'lfref[export]'"
        raise InputError("this format needs a package", got=f"no {' and no '.join(absent)}", remedy=remedy)
