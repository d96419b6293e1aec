"""What is installed from a wheel or a source distribution works from anywhere, without the checkout."""

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

import lfref
from tests.conftest import ROOT

pytestmark = pytest.mark.slow
# Nothing of this process's settings leads to the checkout.
PLAIN = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


def run(*words: object, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(word) for word in words], cwd=folder, env=PLAIN, capture_output=True, text=True)


def done(*words: object, folder: Path) -> str:
    """Standard output of a command that must succeed."""
    ended = run(*words, folder=folder)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> dict[str, Path]:
    """The wheel of the checkout, its source distribution, and the wheel of that one."""
    folder = tmp_path_factory.mktemp("built")
    build = [sys.executable, "-m", "build", "--no-isolation", ROOT, "--outdir"]
    done(*build, "wheel", "--wheel", folder=folder)
    done(*build, "source", folder=folder)
    found = {"wheel": "wheel/*.whl", "source": "source/*.tar.gz", "wheel of the source": "source/*.whl"}
    return {name: next(folder.glob(pattern)) for name, pattern in found.items()}


@pytest.fixture(scope="module")
def command(built, tmp_path_factory) -> Path:
    """The console script of lfref, installed into an environment of its own, which borrows the dependencies."""
    environment = tmp_path_factory.mktemp("environment")
    done(sys.executable, "-m", "venv", "--without-pip", environment, folder=environment)
    paths = sysconfig.get_paths("venv", {"base": str(environment), "platbase": str(environment)})
    lent = sorted({sysconfig.get_path("purelib"), sysconfig.get_path("platlib")})
    Path(paths["purelib"], "lent.pth").write_text("\n".join(lent), encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "--python", environment, "--disable-pip-version-check", "install", "--quiet"]
    offline = ["--no-index", "--no-deps", "--no-build-isolation", "--ignore-installed"]
    done(*pip, *offline, built["source"], folder=environment)
    home = done(Path(paths["scripts"], "python"), "-c", "import lfref; print(lfref.__file__)", folder=environment)
    assert home.startswith(paths["purelib"])
    return Path(paths["scripts"], "lfref")


def test_the_wheel_holds_the_package_its_configuration_and_sweeps(built):
    folders = {"lfref": ROOT / "lfref", "lfref/conf": ROOT / "conf", "lfref/sweeps": ROOT / "sweeps"}
    files = {
        f"{name}/{path.relative_to(folder).as_posix()}"
        for name, folder in folders.items()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    held = zipfile.ZipFile(built["wheel"]).namelist()
    assert {name for name in held if ".dist-info/" not in name} == files


def test_the_wheel_of_the_source_distribution_is_that_of_the_checkout(built):
    ours, theirs = (
        {entry.filename: entry.CRC for entry in zipfile.ZipFile(built[name]).infolist()}
        for name in ("wheel", "wheel of the source")
    )
    assert theirs == ours


def test_what_is_installed_simulates_refocuses_and_reports(command, tmp_path):
    scene = ["n_fields=1", "scene.camera.size=[48,64]", "outputs=[views]"]
    done(command, "simulate", *scene, "output=scenes", folder=tmp_path)
    # This method has no loops to compile: a fresh installation has no cache of machine code.
    words = "refocus", "scenes/simulated_s0_e0_000", "slopes=[0]", "method=exact_fourier", "output=stack"
    done(command, *words, folder=tmp_path)
    done(command, "report", "stack", "output=report", folder=tmp_path)
    assert (tmp_path / "stack" / "stack.exr").is_file()
    assert (tmp_path / "report" / "index.html").is_file()
    assert done(command, "--version", folder=tmp_path).split()[-1] == lfref.__version__
