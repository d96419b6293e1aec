"""How far a reader walks: files and functions of lfref that run, and the deepest chain of calls, for two common uses.

Counted are `lfref refocus FILE` and `lfref.load()(views, slopes)`, each in a process of its own, without what merely
loads modules.

Usage: python benchmarks/walk.py [--chain]
"""

import argparse
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from types import CodeType, FrameType

import torch

import lfref
from lfref.cli.main import main as command

PACKAGE = str(Path(lfref.__file__).parent) + "/"
CO_OPTIMIZED = 1  # set for functions, not for modules and class bodies


class Walk:
    """Records the functions that run while it lasts."""

    def __init__(self) -> None:
        self.functions: set[CodeType] = set()
        self.deepest: list[str] = []

    def record(self, frame: FrameType | None, event: str, _: object) -> None:
        """Called by Python at each call of a function."""
        if event != "call" or frame is None or not _is_ours(frame.f_code):
            return
        code, chain = frame.f_code, []
        while frame is not None:
            if frame.f_code.co_filename.startswith(PACKAGE) and frame.f_code.co_name == "<module>":
                return  # a module that is loaded makes its constants
            if _is_ours(frame.f_code):
                chain.append(f"{frame.f_code.co_filename.removeprefix(PACKAGE)}:{frame.f_code.co_qualname}")
            frame = frame.f_back
        self.functions.add(code)
        if len(chain) > len(self.deepest):
            self.deepest = chain[::-1]

    def __enter__(self) -> "Walk":
        threading.setprofile(self.record)
        sys.setprofile(self.record)
        return self

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)
        threading.setprofile(None)


def _is_ours(code: CodeType) -> bool:
    return code.co_filename.startswith(PACKAGE) and bool(code.co_flags & CO_OPTIMIZED)


def refocus() -> Walk:
    """`lfref refocus FILE` on a simulated light field."""
    with tempfile.TemporaryDirectory() as folder:
        size = "scene.camera.size=[96,128]"
        scene = ["simulate", "n_fields=1", size, "outputs=[views]", "seed=1", f"output={folder}/scene"]
        subprocess.run([sys.executable, "-m", "lfref.cli.main", *scene], check=True, capture_output=True)
        sys.argv = ["lfref", "refocus", f"{folder}/scene/simulated_s1_e0_000", f"output={folder}/stack"]
        with Walk() as walk:
            command()
    return walk


def load() -> Walk:
    """`lfref.load()(views, slopes)`: the network that ships."""
    views = torch.rand(7, 7, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    with Walk() as walk:
        lfref.load()(views, [-7, -3, 0.5])
    return walk


USES = {"refocus": refocus, "load": load}


def main() -> None:
    """Print one line a use; with `--chain` also its deepest chain of calls."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("use", nargs="?", choices=USES, help="only this one, in this process")
    parser.add_argument("--chain", action="store_true", help="print the deepest chain of calls too")
    options = parser.parse_args()
    if options.use is None:
        for use in USES:
            subprocess.run([sys.executable, __file__, use, *["--chain"] * options.chain], check=True)
        return
    walk = USES[options.use]()
    names = {(code.co_filename, code.co_qualname) for code in walk.functions if code.co_name[0] != "<"}
    n_files = len({code.co_filename for code in walk.functions})
    print(f"{options.use}: {n_files} files, {len(names)} functions, {len(walk.deepest)} calls deep")
    if options.chain:
        print("  " + "\n  ".join(walk.deepest))


if __name__ == "__main__":
    main()
