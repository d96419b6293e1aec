"""Writing a refocuser to a file, which gets its name only once its pictures have been compared.

Files are models of other runtimes (`lfref.engines.files`), or safetensors: weights alone, from which lfref builds the
same network on any device.
"""

import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from lfref.engines.engine import BF16, FP16, FP32, NetworkFunction
from lfref.engines.files import file_formats
from lfref.engines.files.file_formats import FORMATS
from lfref.errors import InputError, LfrefError, chosen
from lfref.export import parity
from lfref.export.graphs import Exportable
from lfref.export.parity import TOLERANCES, Row, Tolerance
from lfref.io import atomic
from lfref.io.tensor_files import SUFFIX
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.refocuser.load import load
from lfref.refocuser.networks import NetworkRefocuser, RefinedRefocuser
from lfref.refocuser.refocuser import Refocuser

SAFETENSORS = "safetensors"
WEIGHT_TYPES = {FP32: torch.float32, FP16: torch.float16, BF16: torch.bfloat16}
"""Precision of safetensors -> type of the weights in the file; computation is in float32."""
PRECISIONS = {SAFETENSORS: tuple(WEIGHT_TYPES)} | {name: entry.precisions for name, entry in FORMATS.items()}
"""Format -> its precisions."""
REPORT = ".parity.json"


@dataclass(frozen=True)
class ExportFile:
    """The file to write; InputError if `check_available` refuses its format and precision."""

    path: Path
    """Path of the file without its suffix."""
    format: str
    """A key of `PRECISIONS`."""
    precision: str
    version: str
    """Version of lfref."""
    license: str | None = None
    """Licence of the file; None: not stated."""

    def __post_init__(self) -> None:
        check_available(self.format, self.precision)

    @property
    def file(self) -> Path:
        """The path with the suffix of the format."""
        suffix = SUFFIX if self.format == SAFETENSORS else FORMATS[self.format].suffix
        return self.path.with_name(self.path.name + suffix)

    def tolerance(self, subject: Exportable) -> Tolerance:
        """Allowed error of the file's pictures: for the same arithmetic in PyTorch, only its rounding."""
        is_pytorch = self.format in (SAFETENSORS, "pt2") and self.precision == FP32
        return Tolerance(error=subject.rounding) if is_pytorch else TOLERANCES[self.precision]

    def check_precision(self, subject: Exportable) -> None:
        """Refuse a precision below fp32 of a graph without convolutions, by an InputError: it would change nothing."""
        has_weights = any(isinstance(module, nn.Conv2d) for module in subject.graph.module.modules())
        if self.precision != FP32 and not has_weights:
            raise InputError(
                f"{self.precision} is for the weights of convolutions, and {subject.manifest_entries['name']} has none",
                remedy="take precision=fp32",
            )

    def write_draft(self, folder: Path, refocuser: Refocuser, subject: Exportable) -> Path:
        """Write the file to a folder, unchecked; `subject` is the refocuser as a graph."""
        path = folder / self.file.name
        if self.format == SAFETENSORS:
            write_weights(path, refocuser, self.precision, self.version)
            return path
        manifest = subject.manifest(self.precision, self.version, self.license)
        file_formats.write(path, self.format, subject.graph, manifest)
        return path

    def write_checked(
        self,
        refocuser: Refocuser,
        subject: Exportable,
        fields: Sequence[LightField],
        check_draft: Callable[[Path], None],
    ) -> list[Row]:
        """Write the file, compare its pictures, and give it its name.

        Args:
            refocuser: The refocuser to export.
            subject: The refocuser as a graph, with patches if int8 is to be calibrated.
            fields: Light fields on which the file is tried.
            check_draft: (path of the draft) -> None; raises an error if the file must be refused for another reason.

        Returns:
            The comparison, which is also written to `NAME.SUFFIX.parity.json`.

        Raises:
            LfrefError: The pictures differ, or `check_draft` refused the file; then only the comparison is written.
            InputError: The refocuser cannot be written in this format.
            FileError: The disk refuses.
        """
        with tempfile.TemporaryDirectory() as folder:
            draft = self.write_draft(Path(folder), refocuser, subject)
            engines = {"lfref": weights_run(draft)} if self.format == SAFETENSORS else file_formats.engines(draft)
            rows = list(parity.rows(subject, engines, parity.cases(subject, fields)))
            tolerance = self.tolerance(subject)
            worst = parity.worst(rows, tolerance)
            refusal: LfrefError | None = None
            if worst is not None:
                limit = f"at least {tolerance.psnr_db:g} dB" if tolerance.psnr_db else f"within {tolerance.error:g}"
                refusal = LfrefError(
                    f"{self.file.name} must compute the pictures of {refocuser.name}, {limit}",
                    got=f"{worst['max_error']:.2g}, {worst['psnr_db']:.1f} dB ({worst['engine']}, {worst['case']})",
                    remedy="no file was left; take another format or precision",
                )
            else:
                try:
                    check_draft(draft)
                except LfrefError as error:
                    refusal = error
            summary = {
                "file": self.file.name,
                "precision": self.precision,
                "tolerance": tolerance._asdict(),
                "holds": refusal is None,
                "reason": None if refusal is None else str(refusal),
                "cases": rows,
            }
            report = json.dumps(summary, indent=1, default=str)
            atomic.write_text(self.file.with_name(self.file.name + REPORT), report + "\n")
            if refusal is not None:
                raise refusal
            # The file itself comes last, after its weights: other programs wait for it.
            for part in sorted(Path(folder).iterdir(), key=lambda path: path == draft):
                with atomic.replacing(self.path.with_name(part.name)) as partial:
                    partial.write_bytes(part.read_bytes())
        return rows


def check_available(format: str, precision: str) -> None:
    """Raise InputError if there is no such format, if it has no such precision, or if a package is missing."""
    chosen(f"precision of {format}", precision, dict.fromkeys(chosen("format", format, PRECISIONS)))
    if format != SAFETENSORS:
        file_formats.check_available(format, precision)


def check_weights(refocuser: Refocuser) -> None:
    """Refuse a refocuser without weights, which a safetensors file cannot hold, by an InputError."""
    if not isinstance(refocuser, RefinedRefocuser | NetworkRefocuser) or (
        isinstance(refocuser, NetworkRefocuser) and refocuser.planes is None
    ):
        raise InputError("safetensors must be of a network", got=refocuser.name, remedy="take onnx, pt2 or openvino")


def write_weights(path: Path, refocuser: Refocuser, precision: str, version: str) -> None:
    """Write the weights of a network or a refiner as `NAME.safetensors`; a refocuser without any raises InputError."""
    dtype = chosen("precision of safetensors", precision, WEIGHT_TYPES)
    check_weights(refocuser)
    module: nn.Module
    if isinstance(refocuser, RefinedRefocuser):
        module, entry = refocuser.corrector, refocuser.entry()
    else:
        assert isinstance(refocuser, NetworkRefocuser)
        assert refocuser.planes is not None
        module, is_linear = refocuser.network, refocuser.is_linear is not False
        entry = checkpoint.payload(refocuser.network, refocuser.planes, is_linear)
    state: dict[str, Tensor] = {}
    for name, weight in module.state_dict().items():
        state[checkpoint.PREFIX + name] = weight.to(dtype) if weight.is_floating_point() else weight
    notes = {"version": version, "precision": precision}
    checkpoint.write_weights(path, {"lfref": entry, "state_dict": state}, notes)


def weights_run(path: Path) -> NetworkFunction:
    """The network of a file that `write_weights` wrote, ready to run."""
    refocuser = load(path)
    assert isinstance(refocuser, NetworkRefocuser | RefinedRefocuser)
    return refocuser.network if isinstance(refocuser, NetworkRefocuser) else refocuser.corrector
