"""Hostile and damaged model files: no operator, code, memory or output of theirs gets through.

Their digests are right unless a test says otherwise: whoever writes a file can write the digest too.
"""

import io
import json
import logging
import os
import pickle
import random
import re
import resource
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

import lfref
from lfref.engines.files import as_onnx, as_pt2
from lfref.errors import CheckpointError, LfrefError
from lfref.export import export_file, graphs
from lfref.io import run, tensor_files
from lfref.nets import checkpoint
from lfref.nets.refnet import RefNet
from lfref.refocuser import networks
from tests.conftest import ROOT
from tests.export import cases

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
pytest.importorskip("openvino")
NAMES = {"ckpt": "net.ckpt", "safetensors": "net.safetensors", "onnx": "net.onnx", "pt2": "net.pt2", "xml": "net.xml"}


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    """A folder with the same small network in every format."""
    folder = tmp_path_factory.mktemp("originals")
    refocuser = cases.network()
    checkpoint.save(folder / "net.ckpt", refocuser.network, cases.PLANES)
    subject = graphs.exportable(refocuser, cases.PLANES, cases.GRID)
    for name in export_file.PRECISIONS:
        export_file.ExportFile(folder / "net", name, "fp32", "1.2.3").write_draft(folder, refocuser, subject)
    return folder


@pytest.fixture
def folder(originals, tmp_path):
    """A copy of all files."""
    for path in originals.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def refused(path, part=""):
    """The refusal of a file, which is one line that contains a text."""
    with pytest.raises(LfrefError) as caught:
        lfref.load(path)
    assert "\n" not in str(caught.value)
    assert part in str(caught.value)


def reseal(path, *beside):
    """Write the digest of a changed file anew."""
    path.write_bytes(tensor_files.PLACE.sub(tensor_files.BLANK.encode(), path.read_bytes()))
    tensor_files.fill_digest(path, *beside)


def change_archive(path, change):
    """Change the members of an archive by a function (name, content) -> content."""
    with zipfile.ZipFile(path) as archive:
        members = {member.filename: archive.read(member) for member in archive.infolist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, change(name.partition("/")[2], content))
    tensor_files.fill_archive_digest(path)


def change_graph(path, change):
    """Change the text of the graph of a PT2 archive by a function, in place."""

    def changed(name, content):
        if name != "models/model.json":
            return content
        text = json.loads(content)
        change(text)
        return json.dumps(text).encode()

    change_archive(path, changed)


class Bomb:
    """Makes a folder where it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


# PT2: every operator of ATen that is not ours, and all else that PyTorch would run.


def test_every_operator_of_aten_that_is_not_ours_is_refused():
    schemas = [schema for schema in torch._C._jit_get_all_schemas() if schema.name.startswith("aten::")]
    targets = [
        f"torch.ops.aten.{schema.name.removeprefix('aten::')}.{schema.overload_name or 'default'}" for schema in schemas
    ]
    others = [target for target in targets if target not in as_pt2.OPERATORS]
    assert len(others) > 2000
    assert "torch.ops.aten.from_file.default" in others
    for target in (*others, "torch.ops.load_library", "torch.hub.load", "math.sqrt", "os.system", "_operator.call", ""):
        node = {"target": target, "inputs": [{"name": "self", "arg": {"as_tensor": {"name": "x"}}}], "metadata": {}}
        with pytest.raises(CheckpointError):
            as_pt2._check_nodes(Path("net.pt2"), [node])
    ours = [target for target in as_pt2.OPERATORS if target.startswith("torch.")]
    assert set(ours) <= set(targets)
    assert not [target for target in ours if target.split(".")[-2].endswith("_") and "__" not in target], "in place"


def test_a_graph_that_writes_a_file_is_refused(folder):
    (victim := folder / "victim").write_bytes(b"precious")

    def change(text):
        graph = text["graph_module"]["graph"]
        values = {"filename": {"as_string": str(victim)}, "shared": {"as_bool": True}, "size": {"as_int": 2}}
        calls = {
            "from_file.default": values,
            "fill_.Scalar": {"self": {"as_tensor": {"name": "memory"}}, "value": {"as_float": 0.0}},
        }
        for name, arguments in calls.items():
            node = dict(graph["nodes"][-1], target=f"torch.ops.aten.{name}", name=name.partition(".")[0])
            node["inputs"] = [{"name": key, "arg": value, "kind": 1} for key, value in arguments.items()]
            node["outputs"] = [{"as_tensor": {"name": "memory" if "size" in arguments else "filled"}}]
            graph["nodes"].insert(len(calls) - 2 + ("value" in arguments), node)
        meta = next(iter(graph["tensor_values"].values()))
        graph["tensor_values"] |= {"memory": meta, "filled": meta}

    change_graph(folder / "net.pt2", change)
    refused(folder / "net.pt2", "must hold plain weights")
    assert victim.read_bytes() == b"precious"


def test_kinds_of_arguments_that_ours_do_not_have_are_refused(folder):
    def change(text):
        text["graph_module"]["graph"]["nodes"][-1]["inputs"][0]["arg"] = {"as_graph": {"name": "x", "graph": {}}}

    change_graph(folder / "net.pt2", change)
    refused(folder / "net.pt2", "must hold plain weights")


@pytest.mark.parametrize("member", ["data/weights/weight_0", "data/sample_inputs/model.pt"])
def test_pickles_of_an_archive_are_never_unpickled(folder, member):
    def change(name, content):
        if name.endswith("config.json") and "weights" in member:
            return content.replace(b'"use_pickle": false', b'"use_pickle": true')
        return pickle.dumps(Bomb(folder / "made")) if name == member else content

    change_archive(folder / "net.pt2", change)
    refused(folder / "net.pt2")
    assert not (folder / "made").exists()


SPECIFICATION = (
    '[1, {"type": "collections.defaultdict", "context": "{\\"default_factory_module\\": \\"antigravity\\",'
    ' \\"default_factory_name\\": \\"x\\", \\"dict_context\\": []}", "children_spec": []}]'
)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("target", "torch.hub.load"),
        ("expr_str", "__import__('os').mkdir('made')"),
        ("expr_str", "Pow(Integer(999999999999), Integer(999999999999))"),  # would take hours
        ("guards_code", ["__import__('os').mkdir('made')"]),
        ("in_spec", SPECIFICATION),
        ("out_spec", SPECIFICATION),
        ("metadata", {"nodes": []}),
        ("metadata", {"custom": "{}"}),
        ("treespec_namedtuple_fields", {"os": {"field_names": ["x"]}}),
    ],
)
def test_texts_of_an_archive_name_no_code(folder, key, value, monkeypatch):
    monkeypatch.chdir(folder)
    n_changed = 0

    def put(part):
        nonlocal n_changed
        for child in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
            put(child)
        if isinstance(part, dict) and key in part:
            part[key] = value
            n_changed += 1

    change_graph(folder / "net.pt2", put)
    assert n_changed
    refused(folder / "net.pt2", "must hold plain weights")
    assert not (folder / "made").exists()
    assert "antigravity" not in sys.modules


def test_other_members_and_two_members_of_one_name_are_refused(folder):
    whole = (path := folder / "net.pt2").read_bytes()
    with zipfile.ZipFile(path) as archive:
        weight = next(name for name in archive.namelist() if name.endswith("weight_0"))
    for name in ("archive/data/aotinductor/model/code.so", weight, "archive/data/constants/custom_obj_0"):
        path.write_bytes(whole)
        with zipfile.ZipFile(path, "a") as archive:
            archive.comment = b""
            if name == weight:
                with pytest.warns(UserWarning, match="Duplicate"):
                    archive.writestr(name, b"other")
            else:
                archive.writestr(name, b"\x7fELF")
        tensor_files.fill_archive_digest(path)
        refused(path, "must hold plain weights")


@pytest.mark.parametrize("name", ["net.pt2", "net.ckpt"])
def test_members_that_grow_when_they_are_unpacked_are_refused(folder, name):
    with zipfile.ZipFile(folder / name) as archive:
        members = {member.filename: archive.read(member) for member in archive.infolist()}
    with zipfile.ZipFile(folder / name, "w", zipfile.ZIP_DEFLATED) as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    tensor_files.fill_archive_digest(folder / name)
    refused(folder / name, "must hold plain members")


# ONNX and OpenVINO.


def change_onnx(path, change):
    """Change a model by a function, in place."""
    model = onnx.load(path)
    change(model)
    path.write_bytes(model.SerializeToString())
    if tensor_files.PLACE.search(path.read_bytes()):
        reseal(path)


def put_elsewhere(model):
    """Let the first weights be those of another file."""
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = 1
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "/etc/passwd"


def loop(model):
    """Repeat nothing for 2^62 times."""
    body = onnx.helper.make_graph([], "body", [], [])
    model.graph.node.append(onnx.helper.make_node("Loop", ["count", ""], ["end"], body=body))


@pytest.mark.parametrize(
    "change",
    [
        put_elsewhere,
        lambda model: setattr(model.graph.initializer[0], "data_location", 1),
        lambda model: model.graph.initializer[0].external_data.add(key="location", value="/etc/passwd"),
        lambda model: setattr(model.graph.node[0], "op_type", "NonZero"),
        lambda model: setattr(model.graph.node[0].attribute[0], "ref_attr_name", "x"),
        lambda model: model.training_info.add(),
        loop,
        lambda model: model.opset_import.add(domain="evil", version=1),
        lambda model: model.opset_import.add(domain="com.microsoft", version=1),
        lambda model: setattr(model.graph.node[0], "domain", "com.microsoft"),
        lambda model: setattr(model.opset_import[0], "version", 999),
        lambda model: model.ClearField("metadata_props"),
        lambda model: setattr(model.graph.input[0], "name", "other"),
        lambda model: model.functions.add(name="x"),
        lambda model: model.graph.node[0].attribute.add(name="body", type=5),
        lambda model: model.graph.sparse_initializer.add(),
    ],
)
def test_an_onnx_model_that_does_more_than_ours_is_refused(folder, change):
    change_onnx(folder / "net.onnx", change)
    refused(folder / "net.onnx")


def test_every_operator_of_onnx_that_is_not_ours_is_refused(folder):
    model = onnx.load(folder / "net.onnx")
    names = {(schema.domain, schema.name) for schema in onnx.defs.get_all_schemas()}
    others = [(domain, name) for domain, name in names if domain or name not in as_onnx.OPERATORS]
    assert len(others) > 150
    assert {("", name) for name in as_onnx.OPERATORS} <= names
    for domain, name in others:
        model.graph.node[0].op_type, model.graph.node[0].domain = name, domain
        with pytest.raises(CheckpointError, match="operators"):
            as_onnx._check(Path("net.onnx"), model)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'type="Convolution"', b'type="Loop"'),
        (b'type="Convolution" version="opset1"', b'type="Convolution" version="extension"'),
        (b"<net ", b"<!DOCTYPE net [<!ENTITY a 'b'>]><net "),
        (b'names="views"', b'names=""'),
    ],
)
def test_an_openvino_graph_that_does_more_than_ours_is_refused(folder, old, new):
    path = folder / "net.xml"
    assert old in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old, new))
    reseal(path, folder / "net.bin")
    refused(path)


# Damage and alterations; digests are not written anew.


def stack(path):
    """Output of a file."""
    return lfref.load(path)(cases.FIELDS[1]).numpy()


def scaled(folder, kind):
    """Multiply the weights of a file by 1.2."""
    path = folder / NAMES[kind]
    if kind == "ckpt":
        contents = torch.load(path, weights_only=True)
        contents["state_dict"] = {name: 1.2 * value for name, value in contents["state_dict"].items()}
        torch.save(contents, path)
    elif kind == "onnx":
        model = onnx.load(path)
        for tensor in model.graph.initializer:
            if tensor.data_type == 1:
                tensor.raw_data = (1.2 * np.frombuffer(tensor.raw_data, np.float32)).astype(np.float32).tobytes()
        path.write_bytes(model.SerializeToString())
    elif kind == "pt2":
        comment = zipfile.ZipFile(path).comment
        change = lambda name, content: (  # noqa: E731
            (np.float32(1.2) * np.frombuffer(content, np.float32)).tobytes() if "/weight_" in name else content
        )
        change_archive(path, change)
        path.write_bytes(path.read_bytes()[: -len(comment)] + comment)
    else:
        path = folder / "net.bin" if kind == "xml" else path
        content = path.read_bytes()
        # The header of safetensors states its length.
        start = 8 + int.from_bytes(content[:8], "little") if kind == "safetensors" else 0
        path.write_bytes(content[:start] + (np.float32(1.2) * np.frombuffer(content[start:], np.float32)).tobytes())


@pytest.mark.parametrize("kind", NAMES)
def test_weights_times_another_number_and_a_digest_of_zeros_are_refused(folder, kind):
    path = folder / NAMES[kind]
    whole = path.read_bytes()
    path.write_bytes(tensor_files.PLACE.sub(tensor_files.BLANK.encode(), whole))
    refused(path, "damaged or was changed")
    path.write_bytes(whole)
    assert np.isfinite(stack(path)).all()
    scaled(folder, kind)
    refused(path, "damaged or was changed")


@pytest.mark.parametrize("name", [*NAMES.values(), "net.bin"])
def test_damaged_files_are_refused(folder, name):
    chance, path = random.Random(name), folder / name
    loaded = path.with_suffix(".xml") if name == "net.bin" else path
    whole = path.read_bytes()
    for damage in range(60):
        start, length = chance.randrange(len(whole)), chance.choice((1, 2, 4, 64))
        path.write_bytes(
            [
                whole[:start] + bytes([whole[start] ^ (1 << chance.randrange(8))]) + whole[start + 1 :],
                whole[:start] + chance.randbytes(length) + whole[start:],
                whole[:start] + whole[start + length :],
                whole[: -1 - start],
            ][damage % 4]
        )
        refused(loaded)


@pytest.mark.parametrize("kind", NAMES)
def test_a_file_without_a_digest_is_loaded_with_one_warning(folder, kind, caplog):
    path = folder / NAMES[kind]
    expected, content = stack(path), path.read_bytes()
    caplog.set_level(logging.WARNING)
    if kind == "ckpt":
        contents = torch.load(path, weights_only=True)
        del contents["sha256"]
        torch.save(contents, path)
    elif kind == "safetensors":
        tensors, texts = tensor_files.read_weights(path)
        from safetensors.torch import save_file

        save_file(tensors, path, {name: json.dumps(text) for name, text in texts.items()})
    else:
        # As earlier versions wrote them: format 1; of OpenVINO with a digest of the weights.
        if kind == "pt2":
            change_archive(path, lambda name, text: text.replace(b'"format": 3', b'"format": 1'))
            content = path.read_bytes()
            content = content[: -2 - 77] + bytes(2)
        content = content.replace(b'"format": 3', b'"format": 1').replace(
            b"&quot;format&quot;: 3", b"&quot;format&quot;: 1"
        )
        content = content.replace(b"lfref-sha256:", b"lfref-nothing")
        if kind == "xml":
            import hashlib

            sha256 = hashlib.sha256((folder / "net.bin").read_bytes()).hexdigest().encode()
            content = content.replace(b"<lfref_digest", b'<lfref_weights value="' + sha256 + b'" /><lfref_digest')
        path.write_bytes(content)
    assert not caplog.records
    assert np.array_equal(stack(path), expected)
    assert [record.message.count("has no digest") for record in caplog.records] == [1]


def test_checksums_of_archives_without_a_digest_are_read(folder):
    for name in ("net.ckpt", "net.pt2"):
        content = (folder / name).read_bytes()[: -2 - 77] + bytes(2)
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            largest = max(archive.infolist(), key=lambda member: member.file_size)
        place = largest.header_offset + largest.file_size
        (folder / name).write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        refused(folder / name, "another checksum")


# Weights and configurations of checkpoints.


def save_checkpoint(path, change=lambda state: None, **arguments):
    """A checkpoint whose weights or arguments were changed."""
    network = cases.network().network
    state = {checkpoint.PREFIX + name: value for name, value in network.state_dict().items()}
    change(state)
    entry = checkpoint.payload(network, cases.PLANES)
    entry["network"] |= arguments
    tensor_files.write_checkpoint(path, {"lfref": entry, "state_dict": state})


@pytest.mark.filterwarnings("ignore:torch.quantize_per")
@pytest.mark.parametrize(
    "weight",
    [
        lambda value: value * float("nan"),
        lambda value: value.index_fill(0, torch.tensor([1]), float("inf")),
        lambda value: value.to(torch.complex64),
        lambda value: value.to(torch.int64),
        lambda value: value.to_sparse(),
        lambda value: torch.quantize_per_tensor(value, 0.1, 0, torch.qint8),
        lambda value: value.to("meta"),
        lambda value: torch.zeros(1).expand(value.shape),
        lambda value: {"a": 1},
    ],
)
def test_weights_that_are_no_plain_finite_numbers_are_refused(tmp_path, weight):
    def change(state):
        state["net.trunk.0.weight"] = weight(state["net.trunk.0.weight"])

    save_checkpoint(tmp_path / "net.ckpt", change)
    refused(tmp_path / "net.ckpt", "net.ckpt")


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_exported_weights_that_are_not_finite_are_refused(folder, value):
    number = np.float32(value).tobytes()

    def change(name, content):
        return number + content[4:] if name == "data/weights/weight_0" else content

    change_archive(folder / "net.pt2", change)

    def put(model):
        tensor = next(tensor for tensor in model.graph.initializer if tensor.data_type == 1)
        tensor.raw_data = number + tensor.raw_data[4:]

    change_onnx(folder / "net.onnx", put)
    first = re.search(rb'element_type="f32"[^>]*offset="(\d+)"', (folder / "net.xml").read_bytes())
    weights, place = (folder / "net.bin").read_bytes(), int(first.group(1))
    (folder / "net.bin").write_bytes(weights[:place] + number + weights[place + 4 :])
    reseal(folder / "net.xml", folder / "net.bin")
    tensors, texts = tensor_files.read_weights(folder / "net.safetensors")
    tensors["net.trunk.0.weight"][0, 0, 0, 0] = value
    tensor_files.write_weights(folder / "net.safetensors", tensors, texts)
    for name in ("net.pt2", "net.onnx", "net.xml", "net.safetensors"):
        refused(folder / name, "finite")


HUGE = [
    {"widths": [3000] * 300},
    {"widths": [3000] * 7},
    {"widths": [2] * 10**6},
    {"n_blocks": 10**9},
    {"grid": [10**6, 10**6]},
    {"grid": [10**12, 10**12]},
    {"stem_kernel": 10**6 + 1},
    {"kernel": 10**9 + 1},
    {"stem_width": 10**9},
    {"shuffle": 10**6},
    {"n_planes": 10**12},
    {"channels": 2**62},
]


def test_a_configuration_that_asks_for_memory_is_refused_without_it(tmp_path):
    for number, arguments in enumerate(HUGE):
        save_checkpoint(tmp_path / f"{number}.ckpt", **arguments)
    # Weights as large as the configuration says, all of which are views of one number.
    with torch.device("meta"):
        shapes = {name: value.shape for name, value in RefNet(3, cases.GRID, widths=[3000] * 300).state_dict().items()}
    views = {checkpoint.PREFIX + name: torch.zeros(1).expand(shape) for name, shape in shapes.items()}
    save_checkpoint(tmp_path / "views.ckpt", lambda state: state.update(views), widths=[3000] * 300, stem_width=192)
    program = """
import pathlib, resource, sys, lfref
paths = sorted(pathlib.Path(sys.argv[1]).glob("*.ckpt"))
lfref.load()
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for path in paths:
    try:
        lfref.load(path)
    except lfref.LfrefError as error:
        assert "\\n" not in str(error), error
    else:
        raise AssertionError(path)
print(len(paths), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""
    limited = lambda: resource.setrlimit(resource.RLIMIT_CPU, (60, 60))  # noqa: E731
    done = subprocess.run(
        [sys.executable, "-c", program, tmp_path], cwd=ROOT, capture_output=True, text=True, preexec_fn=limited
    )
    assert done.returncode == 0, done.stderr
    number, kilobytes = map(int, done.stdout.split())
    assert number == len(HUGE) + 1
    assert kilobytes < 200_000


def save_refiner(path, options=(), **arguments):
    """A checkpoint of a refiner with other arguments, or with options of its method."""
    refocuser = cases.refiner()
    entry = networks.refiner_entry(refocuser.corrector, refocuser.base, refocuser.names)
    entry["base"] |= {"operator": "refocus_by_layers", "options": dict(options)}
    entry[networks.REFINER] = entry[networks.REFINER] | arguments
    state = {checkpoint.PREFIX + name: value for name, value in refocuser.corrector.state_dict().items()}
    tensor_files.write_checkpoint(path, {"lfref": entry, "state_dict": state})


@pytest.mark.parametrize(
    "arguments",
    [
        {"n_features": 10**12},
        {"width": 10**9},
        {"n_blocks": 10**9},
        {"shuffle": 10**6},
        {"kernel": 10**9 + 1},
        {"channels": 2**62},
        {"options": {"n_layers": 101}},
        {"options": {"fill": 1e9}},
        {"options": {"ridge": float("nan")}},
        {"options": {"disparities": [0.0, -101.0]}},
        {"options": {"out": {}}},
    ],
)
def test_a_refiner_that_asks_for_memory_is_refused(tmp_path, arguments):
    save_refiner(tmp_path / "net.ckpt", {"n_layers": 100, "fill": 0.5, "border": "edge"})
    assert isinstance(lfref.load(tmp_path / "net.ckpt"), networks.RefinedRefocuser)
    save_refiner(tmp_path / "net.ckpt", **arguments)
    refused(tmp_path / "net.ckpt")


def test_a_dilation_beyond_the_picture_is_refused(tmp_path):
    save_checkpoint(tmp_path / "net.ckpt", dilation=10**6)
    with pytest.raises(LfrefError, match="no farther than the picture"):
        lfref.load(tmp_path / "net.ckpt")(cases.FIELDS[1])


# Paths of the exporting machine.


def test_files_hold_no_path_of_the_machine_that_wrote_them(originals):
    paths = [str(ROOT), tempfile.gettempdir(), sys.prefix, str(Path.home()) + "/", "site-packages", ".py"]
    for path in originals.iterdir():
        content = path.read_bytes()
        assert [part for part in paths if part.encode() in content] == []


def test_training_does_not_go_on_from_a_damaged_checkpoint(tmp_path):
    contents = {"loops": {}, "global_step": 3, "optimizer_states": [torch.rand(100)]}
    tensor_files.write_checkpoint(path := tmp_path / "last.ckpt", contents)
    assert run.steps_done(path) == 3
    whole = path.read_bytes()
    path.write_bytes(whole[:200] + bytes([whole[200] ^ 1]) + whole[201:])
    with pytest.raises(CheckpointError, match="damaged or was changed"):
        run.steps_done(path)
