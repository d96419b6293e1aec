"""Packages that only some commands need: each comes with an extra, as in `pip install 'lfref[report]'`."""

import importlib
from collections.abc import Iterator
from contextlib import contextmanager

from lfref.errors import InputError

EXTRAS = {
    "report": ("matplotlib", "pandas"),
    "video": ("av",),
    "captures": ("h5py",),
    "tensorboard": ("tensorboard",),
    "export": ("onnx", "onnxruntime", "onnxscript"),
    "dashboard": ("wandb_workspaces",),
}
"""Extra -> packages that are imported where they are used, under `needed`."""


@contextmanager
def needed(what: str) -> Iterator[None]:
    """Turn the error about a package of `EXTRAS` that is not installed into one that names the extra to install."""
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        extra = next((extra for extra, packages in EXTRAS.items() if package in packages), None)
        if extra is None:
            raise
        raise InputError(f"{what} needs {package}", got="none", remedy=f"pip install 'lfref[{extra}]'") from error


def check(package: str, what: str) -> None:
    """Raise an InputError if a package is missing, before work is done that needs it later; `what` as in `needed`."""
    with needed(what):
        importlib.import_module(package)
