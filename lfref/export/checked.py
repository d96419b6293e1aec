"""A refocuser written as a file, which gets its name only once it has made the same pictures."""

import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from lfref.engines.engine import BF16, FP16, FP32, Run
from lfref.engines.files import file_formats
from lfref.engines.files import manifest as graph
from lfref.engines.files.file_formats import FORMATS
from lfref.engines.files.manifest import Manifest
from lfref.errors import InputError, LfrefError, chosen
from lfref.export import parity
from lfref.export.graphs import Exportable
from lfref.export.parity import TOLERANCES, Row, Tolerance
from lfref.io import atomic
from lfref.io.tensor_files import SUFFIX
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.refocuser import refined
from lfref.refocuser.load import load
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refined import RefinedRefocuser
from lfref.refocuser.refocuser import Refocuser

# PART weights
# Weights alone, as safetensors: no graph, but what lfref builds the same network of, on any device.

__all__ = ["DTYPES", "SUFFIX", "opened", "write"]

DTYPES = {FP32: torch.float32, FP16: torch.float16, BF16: torch.bfloat16}
"""That weights are kept in, by precision; they are computed with in float32."""


def write(path: Path, refocuser: Refocuser, precision: str, version: str) -> None:
    """Write the weights of a network.

    Args:
        path: The file, `NAME.safetensors`.
        refocuser: A network or a refiner.
        precision: A key of `DTYPES`.
        version: Of lfref.

    Raises:
        InputError: It has no weights, or they can't be kept in that precision.
        FileError: The disk refuses.
    """
    dtype = chosen("precision of safetensors", precision, DTYPES)
    module: nn.Module
    if isinstance(refocuser, NetworkRefocuser) and refocuser.planes is not None:
        module, is_linear = refocuser.network, refocuser.is_linear is not False
        told = checkpoint.payload(refocuser.network, refocuser.planes, is_linear)
    elif isinstance(refocuser, RefinedRefocuser):
        module, told = refocuser.refiner, refined.payload(refocuser.refiner, refocuser.base, refocuser.names)
    else:
        raise InputError("safetensors must be of a network", got=refocuser.name, remedy="take onnx, pt2 or openvino")

    def kept(weight: Tensor) -> Tensor:
        return weight.to(dtype) if weight.is_floating_point() else weight

    state = {checkpoint.PREFIX + name: kept(weight) for name, weight in module.state_dict().items()}
    notes = {"version": version, "precision": precision}
    checkpoint.write_weights(path, {"lfref": told, "state_dict": state}, notes)


def opened(path: Path) -> Run:
    """The network of a file that `write` wrote.

    Args:
        path: The file.

    Raises:
        CheckpointError: Another file.
    """
    refocuser = load(path)
    if isinstance(refocuser, RefinedRefocuser):
        return refocuser.refiner
    assert isinstance(refocuser, NetworkRefocuser)
    return refocuser.network


SAFETENSORS = "safetensors"
PRECISIONS = {SAFETENSORS: tuple(DTYPES)} | {name: each.precisions for name, each in FORMATS.items()}
"""Format -> what it can be of."""
REPORT = ".parity.json"
Further = Callable[[Path], None]


@dataclass(frozen=True)
class Wanted:
    """What file is asked for."""

    path: Path
    """Without a suffix."""
    format: str
    """A key of `PRECISIONS`."""
    precision: str
    version: str
    """Of lfref."""

    def __post_init__(self) -> None:
        precisions = chosen("format", self.format, PRECISIONS)
        chosen(f"precision of {self.format}", self.precision, dict.fromkeys(precisions))

    @property
    def file(self) -> Path:
        """The file itself."""
        suffix = SUFFIX if self.format == SAFETENSORS else FORMATS[self.format].suffix
        return self.path.with_name(self.path.name + suffix)

    def tolerance(self, subject: Exportable) -> Tolerance:
        """How far it may be from what it is made of.

        Args:
            subject: That.
        """
        by_pytorch = self.format in (SAFETENSORS, "pt2") and self.precision == FP32
        return Tolerance(error=subject.rounding) if by_pytorch else TOLERANCES[self.precision]


def write_checked(
    wanted: Wanted, refocuser: Refocuser, subject: Exportable, fields: Sequence[LightField], further: Further
) -> list[Row]:
    """Write a file, try it, and give it its name.

    Args:
        wanted: What file.
        refocuser: What is exported.
        subject: The same as a graph, with patches if whole numbers are to be scaled.
        fields: What it is tried on.
        further: Raises an error over a file that shall not get its name for another reason.

    Returns:
        What was found when it was tried, which stands beside it too, in `NAME.SUFFIX.parity.json`.

    Raises:
        LfrefError: It makes other pictures; then there is no file, but what was found.
        InputError: It cannot be written in that format.
        FileError: The disk refuses.
    """
    with tempfile.TemporaryDirectory() as folder:
        draft = drafted(Path(folder), wanted, refocuser, subject)
        runs = _engines(draft)
        found = list(parity.rows(subject, runs, parity.cases(subject, fields)))
        tolerance = wanted.tolerance(subject)
        beyond = parity.worst(found, tolerance)
        told = {"file": wanted.file.name, "precision": wanted.precision, "tolerance": tolerance._asdict()}
        report = json.dumps(told | {"holds": beyond is None, "cases": found}, indent=1, default=str)
        atomic.write_text(wanted.file.with_name(wanted.file.name + REPORT), report + "\n")
        if beyond is not None:
            got = f"{beyond['max_error']:.2g}, {beyond['psnr_db']:.1f} dB ({beyond['engine']}, {beyond['case']})"
            raise LfrefError(
                _told(wanted, tolerance), got=got, remedy="no file was left; take another format or precision"
            )
        further(draft)
        # What is last is what others look for.
        for part in sorted(Path(folder).iterdir(), key=lambda each: each == draft):
            with atomic.replacing(wanted.path.with_name(part.name)) as partial:
                partial.write_bytes(part.read_bytes())
    return found


def drafted(folder: Path, wanted: Wanted, refocuser: Refocuser, subject: Exportable) -> Path:
    """The file as it is written first, before it was tried.

    Args:
        folder: Where it goes.
        wanted: What file.
        refocuser: What is exported.
        subject: The same as a graph.

    Raises:
        InputError: It cannot be written in that format.
    """
    path = folder / wanted.file.name
    if wanted.format == SAFETENSORS:
        write(path, refocuser, wanted.precision, wanted.version)
        return path
    whole = subject.graph
    manifest = Manifest(
        inputs=whole.inputs,
        output=whole.output,
        precision=wanted.precision,
        sha256=graph.digest(whole.module),
        version=wanted.version,
        **subject.told,
    )
    file_formats.write(path, wanted.format, whole, manifest)
    return path


def _engines(path: Path) -> dict[str, Run]:
    return {"lfref": opened(path)} if path.suffix == SUFFIX else file_formats.engines(path)


def _told(wanted: Wanted, tolerance: Tolerance) -> str:
    limit = f"at least {tolerance.psnr_db:g} dB" if tolerance.psnr_db else f"within {tolerance.error:g}"
    return f"{wanted.file.name} must make the pictures of what it was made of, {limit}"
