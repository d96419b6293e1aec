"""Configurations are checked before Hydra builds anything from `hydra.*`, and overrides by what they override."""

import json
import subprocess
import sys

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf, open_dict

from lfref.cli import composition
from lfref.cli import config as configs
from lfref.errors import InputError

JOBLIB, LOCAL, SLURM, RAY = composition.COMPONENTS["launcher"][1:]
BASIC, OPTUNA = composition.COMPONENTS["sweeper"]
TOUCH = {"_target_": "os.system", "command": "touch sentinel"}
FACTORY = {"()": "os.system", "command": "touch sentinel"}

REFUSED = [
    ("callbacks.evil", TOUCH),
    ("callbacks.evil", [TOUCH]),
    ("callbacks.evil", {"_target_": "pathlib.Path.touch", "_args_": ["sentinel"]}),
    ("callbacks.evil", {"_target_": "lfref.cli.run_folder.OutputFolder", "x": TOUCH}),
    ("callbacks.evil", "${evil}"),
    ("callbacks.output_folder._target_", "os.system"),
    ("callbacks.output_folder", None),
    ("callbacks.checked_jobs", None),
    ("callbacks", {"evil": {"_target_": "${evil._target_}"}}),
    ("launcher._target_", "os.system"),
    ("launcher._target_", "${evil._target_}"),
    ("launcher._target_", "hydra_plugins.evil.Launcher"),
    ("launcher", "${evil}"),
    ("launcher.extra", TOUCH),
    ("launcher", {"_target_": JOBLIB, "pre_dispatch": "__import__('os').system('touch sentinel')"}),
    ("launcher", {"_target_": JOBLIB, "backend": "evil"}),
    ("launcher", {"_target_": JOBLIB, "n_jobs": TOUCH}),
    ("launcher", {"_target_": JOBLIB, "n_jobs": "${evil}"}),
    ("launcher", {"_target_": JOBLIB, "_args_": [1]}),
    ("launcher", {"_target_": SLURM, "setup": ["touch sentinel"]}),
    ("launcher", {"_target_": SLURM, "python": "evil"}),
    ("launcher", {"_target_": SLURM, "srun_args": ["--prolog=evil"]}),
    ("launcher", {"_target_": SLURM, "additional_parameters": {"wrap": "touch sentinel"}}),
    ("launcher", {"_target_": SLURM, "partition": "a\ntouch sentinel"}),
    ("launcher", {"_target_": LOCAL, "setup": ["touch sentinel"]}),
    ("launcher", {"_target_": RAY, "ray": {"init": {"address": "far.away:1"}}}),
    ("launcher", {"_target_": RAY, "ray": {"init": {"runtime_env": {"worker_process_setup_hook": "evil"}}}}),
    ("launcher", {"_target_": "hydra_plugins.hydra_ray_launcher.ray_aws_launcher.RayAWSLauncher"}),
    ("sweeper._target_", "os.system"),
    ("sweeper", {"_target_": BASIC, "params": TOUCH}),
    ("sweeper", {"_target_": OPTUNA, "sampler": TOUCH}),
    ("sweeper", {"_target_": OPTUNA, "sampler": {"_target_": "optuna.samplers.TPESampler", "constraints_func": TOUCH}}),
    ("sweeper", {"_target_": OPTUNA, "sampler": "${evil}"}),
    ("sweeper", {"_target_": OPTUNA, "custom_search_space": "os.system"}),
    ("sweeper", {"_target_": OPTUNA, "storage": "sqlite:///sentinel"}),
    ("job_logging.handlers.evil", FACTORY),
    ("job_logging.handlers.file.class", "os.system"),
    ("job_logging.handlers.file.class", "logging.handlers.SocketHandler"),
    ("job_logging.handlers.file.filename", "sentinel"),
    ("job_logging.handlers.file.filename", "${evil.command}"),
    ("job_logging.handlers.console.stream", "ext://os.system"),
    ("job_logging.handlers.console.level", "ext://os.environ"),
    ("job_logging.handlers.console.level", "cfg://handlers"),
    ("job_logging.handlers.console", {"class": "logging.StreamHandler", ".": {"emit": "ext://os.system"}}),
    ("job_logging.handlers", "${evil}"),
    ("job_logging.formatters.simple", FACTORY),
    ("job_logging.formatters.simple.class", "logging.FileHandler"),
    ("job_logging.formatters.simple.style", "{"),
    ("job_logging.filters", {"evil": FACTORY}),
    ("job_logging.root.handlers", ["ext://os.system"]),
    ("job_logging", "${evil}"),
    ("hydra_logging.handlers.console.stream", "ext://os.system"),
    ("hydra_logging.handlers.file", {"class": "logging.FileHandler", "filename": "sentinel"}),
    ("hydra_logging.handlers.file", {"class": "logging.FileHandler", "filename": composition.LOG_FILE}),
    ("searchpath", ["pkg://antigravity"]),
    ("output_subdir", "../sentinel"),
    ("output_subdir", ".."),
    ("sweep.subdir", "../sentinel"),
    ("sweep.subdir", "/sentinel"),
    ("sweep.subdir", "${evil.command}"),
    ("job.name", "../sentinel"),
    ("job.name", "${evil.command}"),
    ("job.env_set", {"LD_PRELOAD": "evil.so"}),
    ("job.env_copy", ["HOME"]),
    ("runtime.output_dir", "/sentinel"),
]
ALLOWED = [
    ("verbose", True),
    ("verbose", ["lfref"]),
    ("run.dir", "anywhere"),
    ("sweep.dir", "anywhere"),
    ("sweep.subdir", "${hydra:job.num}_${hydra.job.override_dirname}"),
    ("job.name", "train_ddp_process_1"),
    ("output_subdir", ".hydra"),
    ("job_logging.root.level", "DEBUG"),
    ("job_logging.formatters.simple.format", "[%(asctime)s] %(message)s"),
    ("job_logging.handlers.console.stream", "ext://sys.stderr"),
    ("launcher", {"_target_": JOBLIB, "n_jobs": 2, "pre_dispatch": "2*n_jobs", "backend": None, "temp_folder": None}),
    (
        "launcher",
        {
            "_target_": SLURM,
            "partition": "gpu",
            "timeout_min": 60,
            "name": "${hydra.job.name}",
            "submitit_folder": "${hydra.sweep.dir}/.submitit/%j",
            "setup": None,
            "additional_parameters": {},
        },
    ),
    ("launcher", {"_target_": RAY, "ray": {"init": {"address": None, "num_cpus": 2}, "remote": {"num_gpus": 1}}}),
    ("sweeper.max_batch_size", 4),
    ("sweeper", {"_target_": BASIC, "params": {"net.activation": "relu,elu"}, "max_batch_size": None}),
    (
        "sweeper",
        {
            "_target_": OPTUNA,
            "n_trials": 20,
            "storage": None,
            "sampler": {"_target_": "optuna.samplers.TPESampler", "seed": 1},
        },
    ),
]


@pytest.fixture(scope="module")
def whole():
    """A composed configuration with the node of Hydra."""
    with initialize_config_dir(str(configs.directory()), version_base="1.3"):
        return compose("train", return_hydra_config=True)


@pytest.fixture
def hydra_with(whole):
    """Function (key, value) -> the node of Hydra with that in it."""

    def make(key, value):
        changed = whole.copy()
        with open_dict(changed):
            changed.evil = TOUCH
            is_a_whole = key in ("launcher", "sweeper")
            OmegaConf.update(changed, f"hydra.{key}", value, merge=not is_a_whole, force_add=True)
        return changed.hydra

    return make


@pytest.mark.parametrize(("key", "value"), REFUSED, ids=str)
def test_what_could_run_or_open_what_it_names_is_refused(hydra_with, key, value):
    with pytest.raises(InputError, match=rf"hydra\.{key.partition('.')[0]}"):
        composition.check(hydra_with(key, value))


@pytest.mark.parametrize(("key", "value"), ALLOWED, ids=str)
def test_what_people_need_is_allowed(hydra_with, key, value):
    composition.check(hydra_with(key, value))


@pytest.mark.parametrize("choice", ["job_logging=none", "job_logging=disabled", "job_logging=stdout"])
def test_hydras_own_choices_are_allowed(choice):
    with initialize_config_dir(str(configs.directory()), version_base="1.3"):
        composition.check(compose("train", [f"hydra/{choice}"], return_hydra_config=True).hydra)


FILES = {
    "scene/evil.yaml": "_target_: os.system\ncommand: touch sentinel\n",
    "scene/nested.yaml": (
        "defaults: [plane]\nsurfaces:\n- _target_: lfref.simulator.scene.Surface\n"
        "  geometry: {_target_: pathlib.Path.touch, _partial_: false, self: sentinel}\n"
    ),
    "scene/callback.yaml": (
        "# @package _global_\ndefaults: [/scene@scene: plane]\n"
        "hydra: {callbacks: {evil: {_target_: os.system, command: touch sentinel}}}\n"
    ),
    "scene/log.yaml": (
        "# @package _global_\nhydra: {job_logging: {handlers: {evil: {(): os.system, command: touch sentinel}}}}\n"
    ),
    "scene/sweep.yaml": (
        "# @package _global_\nhydra: {sweeper: {params: {'hydra.searchpath': '[pkg://evil_package]', seed: '1,2'}}}\n"
    ),
    "hydra/launcher/evil.yaml": "_target_: os.system\ncommand: touch sentinel\n",
    "simulate.yaml": "hydra: {searchpath: ['pkg://evil_package']}\n",
    "other.yaml": "hydra: {callbacks: {evil: {_target_: os.system, command: touch sentinel}}}\n",
    "evil_package/__init__.py": "open('sentinel', 'w')\n",
    "evil.pickle": "cos\nsystem\n(S'touch sentinel'\ntR.",
}
LINES = [
    ["scene=evil"],
    ["scene=nested"],
    ["scene=callback"],
    ["scene=log"],
    ["scene=plane", "+hydra.callbacks.evil={_target_:os.system,command:'touch sentinel'}"],
    ["scene=plane", "++hydra.callbacks.output_folder._target_=os.system"],
    ["scene=plane", "hydra={callbacks:{evil:{_target_:os.system,command:'touch sentinel'}}}"],
    ["scene=plane", "hydra/launcher=evil", "--multirun", "seed=1,2"],
    ["scene=plane,log", "--multirun"],
    ["scene=sweep", "--multirun"],
    ["scene=plane", "--multirun", "seed=1,2", "hydra.sweeper.params={hydra.searchpath:'[pkg://evil_package]'}"],
    [
        "scene=plane",
        "--multirun",
        "seed=1,2",
        "+hydra.job_logging.filters={e:{(): os.system, command: touch sentinel}}",
    ],
    ["scene=plane", "hydra.searchpath=[pkg://evil_package]"],
    ["scene=plane", "hydra.searchpath=[pkg://evil_package]", "--info", "defaults"],
    ["scene=plane", "hydra.hydra_logging.handlers.console.stream=ext://os.system", "--help"],
    ["--experimental-rerun", "evil.pickle"],
    ["--experimental", "evil.pickle"],
    ["--config-name", "other"],
    ["--config-path", "elsewhere"],
    ["scene=plane", "+scene.light={_target_:os.system,command:'touch sentinel'}"],
    ["scene=plane", "planes._target_=lfref.cli.command.sys.exit"],
    ["scene=plane", "+planes._args_=[1]"],
]
RUNNER = """
import json, sys
from lfref.cli import main
for words in json.loads(sys.argv[1]):
    sys.argv = ["lfref", *words]
    try:
        main.main()
        status = 0
    except SystemExit as leaving:
        status = leaving.code
    print("left:", json.dumps([status, words]), flush=True)
"""


def test_the_command_line_reaches_nothing_either(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    small = ["scene.camera.size=[24,24]", "scene.camera.grid=[3,3]", "outputs=[disparity]"]
    good = ["simulate", "scene=plane", *small]
    lines = [["simulate", "--config-dir", str(tmp_path), f"output=runs/{k}", *line] for k, line in enumerate(LINES)]
    command = [sys.executable, "-W", "error::UserWarning", "-c", RUNNER, json.dumps([*lines, good])]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    left = [json.loads(line.removeprefix("left:")) for line in run.stdout.splitlines() if line.startswith("left:")]
    assert [words for status, words in left if status not in (1, 2)] == [good]
    assert len(left) == len(LINES) + 1
    assert "Traceback" not in run.stderr
    assert len(run.stderr.splitlines()) <= len(LINES) + 2
    assert not (tmp_path / "sentinel").exists()


BASE = OmegaConf.create(
    {
        "flag": False,
        "count": 3,
        "size": 0.5,
        "name": "x",
        "nothing": None,
        "needed": "???",
        "data": {"patch": 192, "scenes": "${scene}", "seed": "${count}"},
        "scene": {"parts": [{"opacity": 1.0}], "camera": {"size": [1, 2]}},
        "net": {"_target_": "lfref.geometry.even_planes", "n": 3, "first": -1.0, "last": 1.0},
        "methods": {},
        "callbacks": {"best": {"x": 1}, "guard": None},
        "trainer": {"devices": 1, "fast_dev_run": False},
    }
)


def check_overrides(*words):
    composition.check_overrides(BASE, OverridesParser.create().parse_overrides(list(words)), ["alphas"])


@pytest.mark.parametrize(
    "word",
    [
        "flag=true", "flag=null", "count=4", "count=2.5", "size=1", "size=1e-3", "name=3", "nothing=abc", "needed=1",
        "data.patch=96", "data.scenes.camera.size=[3,4]", "scene.parts.0.opacity=0.5",
        "data.seed=7", "count=${data.patch}", "~data.patch", "trainer.devices=auto", "trainer.fast_dev_run=1",
        "+methods.mine={name:x}", "+methods.mine.name=x", "+callbacks.timer={_target_:x}", "++count=3",
        "++methods.mine={}", "count=1,2", "data={patch:3}", "net.first=2",
    ],
)  # fmt: skip
def test_what_fits_passes(word):
    check_overrides(word)


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("alpha=[1]", r"got 'alpha'; perhaps alphas"),
        ("cuont=1", r"got 'cuont'; perhaps count"),
        ("cuont=1,2", r"got 'cuont'; perhaps count"),
        ("data.ptch=1", r"got 'data.ptch'; perhaps data\.patch"),
        ("data.scenes.camera.siez=1", r"perhaps data\.scenes\.camera\.size"),
        ("scene.parts.1.opacity=1", r"got 'scene\.parts\.1\.opacity'"),
        ("scene.parts.0.opacty=1", r"perhaps scene\.parts\.0\.opacity"),
        ("nothing.below=1", r"got 'nothing\.below'"),
        ("zzz=1", r"--cfg job shows all"),
        ("+cuont=1", r"got 'cuont'; perhaps count"),
        ("++cuont=1", r"got 'cuont'; perhaps count"),
        ("+data.ptch=1", r"perhaps data\.patch"),
        ("+net.frist=1", r"perhaps net\.first"),
        ("+net._args_=[1]", r"got 'net\._args_'"),
        ("flag=yes_please", r"flag must be true or false; got 'yes_please'"),
        ("flag=1", r"flag must be true or false; got 1"),
        ("flag='true'", r"flag must be true or false; got 'true'"),
        ("count=many", r"count must be a number; got 'many'"),
        ("count=true", r"count must be a number; got True"),
        ("count=[1]", r"count must be a number; got \[1\]"),
        ("size=big", r"size must be a number; got 'big'"),
        ("data.seed=x", r"data\.seed must be a number"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_nearest(word, said):
    with pytest.raises(InputError, match=said):
        check_overrides(word)


def test_a_missing_argument_of_a_component_may_be_added():
    base = OmegaConf.create({"net": {"_target_": "lfref.geometry.even_planes", "n": 3}})
    composition.check_overrides(base, OverridesParser.create().parse_overrides(["+net.last=2"]), [])
    with pytest.raises(InputError, match=r"got 'net\.last'; add \+net\.last=VALUE"):
        composition.check_overrides(base, OverridesParser.create().parse_overrides(["net.last=2"]), [])


def test_options_of_wandb_that_are_allowed_may_be_added():
    base = OmegaConf.create({"logger": {"wandb": {"_target_": "lfref.cli.wandb_runs.WandbLogger", "name": None}}})
    for word in ("entity=team", "tags=[a,b]", "notes=why", "mode=offline", "group=all", "id=x", "job_type=test"):
        composition.check_overrides(base, OverridesParser.create().parse_overrides([f"+logger.wandb.{word}"]), [])
    for name in ("dir", "settings", "experiment"):
        words = OverridesParser.create().parse_overrides([f"+logger.wandb.{name}=x"])
        with pytest.raises(InputError, match=f"got 'logger.wandb.{name}'"):
            composition.check_overrides(base, words, [])


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["{capture}", "correct=off"], "no corrections at off; correct=none corrects nothing"),
        (["{capture}", "correct=false"], "no corrections at False; correct=none corrects nothing"),
        (["{capture}", "reader.size=24,32"], "write reader.size=[24,32], or add --multirun"),
        (["{capture}", "reader.size=24"], "size (reader.size) must be [height,width]"),
        (["{capture}", "--metod", "learned"], "got 'metod'; perhaps method"),
        (["{capture}", "aperture=disk"], "perhaps aperture=disc"),
        (["{capture}", "white={capture}/no"], "/no cannot be read; got no such file"),
        (["{capture}/no", "{capture}"], "/no cannot be read; got no such file"),
        ([], "input must be given; got none; add PATH"),
    ],
)
def test_mistakes_are_answered_by_the_line_to_write(lfref, tmp_path, words, expected):
    words = [word.format(capture=tmp_path) for word in words]
    status, error = lfref("refocus", *words, f"output={tmp_path}/out")
    assert status in (1, 2)
    assert expected in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_choice_with_several_places_names_them(lfref, tmp_path):
    _, error = lfref("view", tmp_path, "method=learned")
    assert "write method@methods.first=learned or method@methods.second=learned" in error


def test_the_sweep_of_a_list_is_no_missing_file(lfref, tmp_path):
    status, error = lfref("refocus", "--multirun", "input=a,b", f"output={tmp_path}/out")
    assert status == 1
    assert "2 of the runs failed" in error


LATE = """
import sys
from lfref.cli import main
sys.argv = ["lfref", *sys.argv[1:]]
try:
    main.main()
except SystemExit as leaving:
    status = leaving.code or 0
else:
    status = 0
print("torch" in sys.modules, status, file=sys.stderr)
"""


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (["--help"], 0),
        (["refocus", "--help"], 0),
        (["train", "--help"], 0),
        (["refocus", ".", "metod=learned"], 2),
        (["refocus", ".", "method=lerned"], 2),
        (["refocus", ".", "method=shift_and_sum", "method.operator.interpolaton=cubic"], 2),
        (["refocus", ".", "+apertur=disc"], 2),
        (["refocus", ".", "reader.views=many"], 2),
        (["refocus", "nowhere"], 1),
        (["info"], 2),
    ],
)
def test_pytorch_is_not_imported_for_help_or_a_mistake(tmp_path, words, status):
    run = subprocess.run([sys.executable, "-c", LATE, *words], cwd=tmp_path, capture_output=True, text=True)
    assert run.stderr.splitlines()[-1] == f"False {status}", run.stderr


def test_files_may_be_added_only_where_a_command_reads_them(lfref):
    assert lfref("eval", "--cfg", "job", "input=x", "+method@methods.s=shift_and_sum")[0] == 0
    status, error = lfref("eval", "--cfg", "job", "input=x", "+method@metods.s=shift_and_sum")
    assert status == 2
    assert "got 'method@metods.s'; perhaps methods" in error
