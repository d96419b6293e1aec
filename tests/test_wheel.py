"""What is installed from a wheel or a source distribution works from anywhere, without the checkout."""

import email
import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

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
    """The console script of lfref, installed from the source distribution into an environment of its own.

    The wheel has the same files, as a test below shows. The environment borrows the dependencies of lfref by a `.pth`
    file, in which the `.pth` files of editable installations do not count.
    """
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


def page_links(text: str) -> list[str]:
    """Targets of the links and pictures of a page of Markdown, as an index renders it."""
    tokens = [child for token in MarkdownIt().parse(text) for child in token.children or []]
    names = {"link_open": "href", "image": "src"}
    return [str(token.attrs[names[token.type]]) for token in tokens if token.type in names]


def test_links_of_the_page_on_the_index_lead_to_files_of_this_version(tmp_path):
    address = "https://code.example/owner/lfref"
    env = PLAIN | {"LFREF_REPOSITORY": address}
    words = [sys.executable, "-m", "build", "--no-isolation", "--wheel", ROOT, "--outdir", tmp_path]
    subprocess.run(words, env=env, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        metadata = email.message_from_string(archive.read(name).decode())
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert f"Source, {address}" in metadata.get_all("Project-URL")
    links = page_links(metadata.get_payload())
    originals = page_links((ROOT / "README.md").read_text("utf-8"))
    assert len(links) == len(originals) > 16
    for link, original in zip(links, originals, strict=True):
        target, _, anchor = original.partition("#")
        assert (ROOT / target).is_file()
        view = "raw" if target.startswith("docs/pictures/") else "blob"
        assert link == f"{address}/{view}/v{lfref.__version__}/{target}" + (f"#{anchor}" if anchor else "")


def test_what_is_installed_finds_its_version_and_sweeps(command, tmp_path):
    assert done(command, "--version", folder=tmp_path).split()[-1] == lfref.__version__
    refused = run(command, "train", "-m", "+sweep=magic", folder=tmp_path)
    assert refused.returncode == 2
    assert "activation, beta_gamma, blocks, normalization" in refused.stderr


def test_what_is_installed_simulates_refocuses_and_reports(command, tmp_path):
    scene = ["n_fields=1", "scene.camera.size=[48,64]", "outputs=[views]"]
    done(command, "simulate", *scene, "output=scenes", folder=tmp_path)
    # This method has no loops to compile: a fresh installation has no cache of machine code.
    done(
        command,
        "refocus",
        "scenes/simulated_s0_e0_000",
        "slopes=[0]",
        "method=exact_fourier",
        "output=stack",
        folder=tmp_path,
    )
    done(command, "report", "stack", "output=report", folder=tmp_path)
    assert (tmp_path / "stack" / "stack.exr").is_file()
    assert (tmp_path / "report" / "index.html").is_file()
