"""What a measurement was made on, so that a table can be read a year later."""

import os
import platform
from importlib import metadata
from pathlib import Path

import torch

PACKAGES = ("torch", "numpy", "lightning", "torchmetrics", "OpenImageIO", "numba")


def facts(device: torch.device) -> dict[str, str | int | None]:
    """Machine, libraries and thread count.

    Args:
        device: Where the work is done.
    """
    return {
        "processor": processor(),
        "cores": os.cpu_count() or 1,
        "threads": torch.get_num_threads(),
        "device": torch.cuda.get_device_name(device) if device.type == "cuda" else device.type.upper(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "lfref": metadata.version("lfref"),
        **{package: version(package) for package in PACKAGES},
    }


def version(package: str) -> str | None:
    """Version of a package; None where it is not installed.

    Args:
        package: Its name.
    """
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def processor() -> str:
    """Name of the processor and its widest vector instructions."""
    listing = Path("/proc/cpuinfo")
    lines = listing.read_text().splitlines() if listing.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.processor()} ({torch.backends.cpu.get_cpu_capability()})"
