"""What the 4D light field benchmark of HCI (Heidelberg and Konstanz) lays beside its views.

Its disparity counts the other way round: near things have positive disparity there, and move to the left where the
camera moves to the right, which is a negative slope here. Source: Honauer et al., "A Dataset and Evaluation
Methodology for Depth Estimation on 4D Light Fields", 2016.
"""

import configparser
from pathlib import Path

import torch
from torch import Tensor

from lfref.errors import FileError
from lfref.io import explain, pfm

PARAMETERS = "parameters.cfg"


def read_disparity(path: str | Path) -> Tensor:
    """Read a disparity map of the benchmark, as `gt_disp_lowres.pfm`, with our sign.

    Args:
        path: The PFM file.

    Returns:
        Slope at which each pixel of the central view is sharp, in pixels per view step, float32, [H, W].

    Raises:
        FileError: The file is missing, damaged or no grey PFM.

    Example:
        >>> from lfref.io import hci, pfm
        >>> pfm.write("gt_disp_lowres.pfm", np.full((24, 32), 1.5, np.float32))
        >>> hci.read_disparity("gt_disp_lowres.pfm").unique()
        tensor([-1.5000])
    """
    values = pfm.read(path)
    if values.shape[2] != 1:
        raise FileError(f"{path} must be a grey PFM file", got="colours", remedy="give gt_disp_lowres.pfm")
    return -torch.from_numpy(values[..., 0])


def metadata(folder: Path) -> dict[str, str]:
    """What `parameters.cfg` says of the camera and the scene.

    Args:
        folder: Of the views; anything else says nothing.

    Returns:
        Some of `scene`, `focal length`, `f-number`, `sensor size`, `baseline`, `focus distance`, and `slopes`: the
        range of slopes (of their disparities, our sign), in pixels per view step.

    Raises:
        FileError: The file cannot be read, or is none of theirs.
    """
    if not (folder / PARAMETERS).is_file():
        return {}
    parser = configparser.ConfigParser(interpolation=None)
    try:
        with explain.explained(folder / PARAMETERS, "read"):
            parser.read_string((folder / PARAMETERS).read_text("utf-8"))
        known = {name: where for name, where in KEYS.items() if where[1] in parser[where[0]]}
        said = {name: parser[section][key] + unit for name, (section, key, unit) in known.items()}
        low, high = (-float(parser["meta"][key]) for key in ("disp_max", "disp_min"))
    except (configparser.Error, KeyError, ValueError) as error:
        got = explain.one_line(str(error))
        raise FileError(f"{folder / PARAMETERS} must be of an HCI light field", got=got) from error
    return said | {"slopes": f"{low:g} {high:g}"}


KEYS = {
    "scene": ("meta", "scene", ""),
    "focal length": ("intrinsics", "focal_length_mm", " mm"),
    "f-number": ("intrinsics", "fstop", ""),
    "sensor size": ("intrinsics", "sensor_size_mm", " mm"),
    "baseline": ("extrinsics", "baseline_mm", " mm"),
    "focus distance": ("extrinsics", "focus_distance_m", " m"),
}
"""Key of the metadata -> section and key of the file, and unit."""
