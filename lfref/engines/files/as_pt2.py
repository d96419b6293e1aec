"""PT2 archives of `torch.export`: PyTorch runs them, and its compiler turns them into programs.

`torch.export.load` unpickles members of the archive, evaluates expressions as Python, imports modules and calls
functions of PyTorch by name. Archives are hostile input, so each is checked first: plain weights, expressions of sizes,
and the operators that our own networks need.
Each format has its own module.
"""

import copy
import io
import json
import math
import re
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lfref.engines.engine import BF16, FP16, FP32, NetworkFunction
from lfref.engines.files.manifest import KEY, Graph, Manifest, parse
from lfref.engines.files.network_copies import half_convolutions
from lfref.errors import CheckpointError, first_line
from lfref.io import atomic, tensor_files

PRECISIONS = (FP32, FP16, BF16)
PACKAGES: tuple[str, ...] = ()
LARGEST = 2**33
"""Largest size of an archive, and of all its members together, in bytes."""
LARGEST_TEXT = 2**26
"""Largest size of one text of an archive, in bytes."""
LONGEST_EXPRESSION = 10000
"""Greatest length of an expression, in characters."""
MEMBERS = re.compile(
    r"\.data/(version|serialization_id)|byteorder|archive_format|archive_version|models/model\.json|extra/lfref"
    r"|data/(weights|constants)/(weight_\d+|tensor_\d+|model_(weights|constants)_config\.json)"
)
"""Names of members that an archive may have; compiled code for processors is not among them."""
SAMPLE_INPUTS = "data/sample_inputs/model.pt"
"""A member that PyTorch would unpickle unless it is empty."""
OPERATORS = {
    "_operator.add": "sym_int int",
    "_operator.floordiv": "sym_int int",
    "_operator.mul": "sym_int int",
    "_operator.sub": "sym_int int",
    "torch.ops.aten.__and__.Tensor": "tensor",
    "torch.ops.aten.__or__.Tensor": "tensor",
    "torch.ops.aten._assert_tensor_metadata.default": "tensor scalar_type device layout",
    "torch.ops.aten.abs.default": "tensor",
    "torch.ops.aten.add.Tensor": "tensor float int sym_int",
    "torch.ops.aten.addcmul.default": "tensor",
    "torch.ops.aten.amax.default": "ints tensor bool",
    "torch.ops.aten.amin.default": "ints tensor",
    "torch.ops.aten.arange.default": "sym_int device bool int scalar_type",
    "torch.ops.aten.arange.start": "int device bool scalar_type",
    "torch.ops.aten.arange.start_step": "sym_int device bool int",
    "torch.ops.aten.avg_pool2d.default": "tensor ints int",
    "torch.ops.aten.batch_norm.default": "tensor bool float",
    "torch.ops.aten.cat.default": "tensors int",
    "torch.ops.aten.ceil.default": "tensor",
    "torch.ops.aten.clamp.default": "float int none sym_int tensor",
    "torch.ops.aten.conv2d.default": "tensor none ints int",
    "torch.ops.aten.cos.default": "tensor",
    "torch.ops.aten.cumsum.default": "int tensor",
    "torch.ops.aten.diag.default": "tensor",
    "torch.ops.aten.div.Tensor": "float int sym_int tensor",
    "torch.ops.aten.div.Tensor_mode": "string tensor int",
    "torch.ops.aten.elu.default": "tensor float",
    "torch.ops.aten.eq.Scalar": "int sym_int tensor",
    "torch.ops.aten.eq.Tensor": "tensor",
    "torch.ops.aten.expand.default": "sym_ints tensor",
    "torch.ops.aten.eye.default": "int scalar_type device bool",
    "torch.ops.aten.flatten.using_ints": "tensor int",
    "torch.ops.aten.flip.default": "ints tensor",
    "torch.ops.aten.floor.default": "tensor",
    "torch.ops.aten.floor_divide.default": "tensor int",
    "torch.ops.aten.full.default": "bool device float ints sym_int int scalar_type",
    "torch.ops.aten.gather.default": "int tensor",
    "torch.ops.aten.ge.Scalar": "tensor int float sym_int",
    "torch.ops.aten.ge.Tensor": "tensor",
    "torch.ops.aten.gelu.default": "tensor",
    "torch.ops.aten.group_norm.default": "tensor int float bool",
    "torch.ops.aten.gt.Scalar": "tensor int float",
    "torch.ops.aten.gt.Tensor": "tensor",
    "torch.ops.aten.hardsigmoid.default": "tensor",
    "torch.ops.aten.index_select.default": "tensor int",
    "torch.ops.aten.instance_norm.default": "tensor none bool float",
    "torch.ops.aten.item.default": "tensor",
    "torch.ops.aten.le.Scalar": "float tensor",
    "torch.ops.aten.le.Tensor": "tensor",
    "torch.ops.aten.leaky_relu.default": "tensor float",
    "torch.ops.aten.lt.Scalar": "float int tensor sym_int",
    "torch.ops.aten.lt.Tensor": "tensor",
    "torch.ops.aten.matmul.default": "tensor",
    "torch.ops.aten.maximum.default": "tensor",
    "torch.ops.aten.mean.default": "tensor",
    "torch.ops.aten.mean.dim": "bool ints tensor",
    "torch.ops.aten.minimum.default": "tensor",
    "torch.ops.aten.mul.Tensor": "tensor float int sym_int",
    "torch.ops.aten.narrow.default": "tensor int sym_int",
    "torch.ops.aten.neg.default": "tensor",
    "torch.ops.aten.ones.default": "bool device ints",
    "torch.ops.aten.ones_like.default": "tensor bool",
    "torch.ops.aten.pad.default": "tensor ints string float",
    "torch.ops.aten.permute.default": "tensor ints",
    "torch.ops.aten.pixel_shuffle.default": "tensor int",
    "torch.ops.aten.pixel_unshuffle.default": "tensor int",
    "torch.ops.aten.pow.Tensor_Scalar": "float int tensor",
    "torch.ops.aten.pow.Tensor_Tensor": "tensor",
    "torch.ops.aten.reciprocal.default": "tensor",
    "torch.ops.aten.relu.default": "tensor",
    "torch.ops.aten.remainder.Scalar": "int tensor",
    "torch.ops.aten.remainder.Tensor": "tensor",
    "torch.ops.aten.reshape.default": "tensor ints sym_ints",
    "torch.ops.aten.round.default": "tensor",
    "torch.ops.aten.rsub.Scalar": "tensor sym_int int float",
    "torch.ops.aten.select.int": "tensor int",
    "torch.ops.aten.sign.default": "tensor",
    "torch.ops.aten.silu.default": "tensor",
    "torch.ops.aten.sin.default": "tensor",
    "torch.ops.aten.sinc.default": "tensor",
    "torch.ops.aten.slice.Tensor": "tensor int sym_int none",
    "torch.ops.aten.softplus.default": "tensor float",
    "torch.ops.aten.sort.default": "tensor",
    "torch.ops.aten.split.Tensor": "tensor int",
    "torch.ops.aten.split_with_sizes.default": "tensor ints int",
    "torch.ops.aten.sqrt.default": "tensor",
    "torch.ops.aten.square.default": "tensor",
    "torch.ops.aten.squeeze.dim": "tensor int",
    "torch.ops.aten.stack.default": "int tensors",
    "torch.ops.aten.sub.Tensor": "float int sym_int tensor",
    "torch.ops.aten.sum.default": "tensor",
    "torch.ops.aten.sum.dim_IntList": "tensor ints",
    "torch.ops.aten.sym_size.int": "tensor int",
    "torch.ops.aten.to.device": "tensor device scalar_type",
    "torch.ops.aten.to.dtype": "tensor scalar_type",
    "torch.ops.aten.to.dtype_layout": "tensor scalar_type device layout",
    "torch.ops.aten.transpose.int": "tensor int",
    "torch.ops.aten.unbind.int": "tensor",
    "torch.ops.aten.unflatten.int": "tensor int ints sym_ints",
    "torch.ops.aten.unsqueeze.default": "tensor int",
    "torch.ops.aten.where.Scalar": "tensor float",
    "torch.ops.aten.where.ScalarOther": "tensor float",
    "torch.ops.aten.where.ScalarSelf": "tensor float",
    "torch.ops.aten.where.self": "tensor",
    "torch.ops.aten.zeros.default": "bool device ints scalar_type",
    "torch.ops.aten.zeros_like.default": "tensor bool",
}
"""Functions that a graph may call, and the kinds of their arguments: those that our networks and operators need."""
BYTES = {5: 8, 6: 2, 7: 4, 8: 8, 12: 1, 13: 2}
"""Bytes of each type of weights and constants, by its number in archives: int64, float16, float32, float64, bool,
bfloat16."""
NOTES = ("stack_trace", "nn_module_stack", "torch_fn", "source_fn_stack", "from_node", "custom")
"""Notes of the exporter about nodes: lines and paths of source code."""
EXPRESSION = re.compile(
    r"('[su]\d+'|Pow\(Symbol\('s\d+', positive=True, integer=True\), Integer\(2\)\)"
    r"|\b(Symbol|Integer|Add|Mul|FloorDiv|CeilDiv|Mod|PythonMod|Max|Min|positive|nonnegative|integer|True)\b"
    r"|\d{1,12}\b|[ (),=-])*"
)
"""An expression of sizes; any other text could be Python code, and powers of other numbers might take hours."""
SPECIFICATION = re.compile(
    r'([\[\]{}:, 1]|"(type|context|children_spec|null|\[\]|builtins\.(tuple|list|dict))"|null)*', re.ASCII
)
"""A description of nested arguments; for other containers, PyTorch imports the modules that a file names."""


def write(path: Path, graph: Graph, manifest: Manifest) -> None:
    """Write an archive as `NAME.pt2`.

    Raises:
        FileError: The disk refuses.
    """
    from torch.utils._sympy.numbers import int_oo  # slow to import: only writing needs it
    from torch.utils._sympy.value_ranges import ValueRanges

    is_full = manifest.precision == FP32
    module = copy.deepcopy(graph.module) if is_full else half_convolutions(graph.module, manifest.precision).eval()
    # Weights in another memory order would be stored as parts of other tensors.
    for weight in (*module.parameters(), *module.buffers()):
        weight.data = weight.data.clone(memory_format=torch.contiguous_format)
    axes = tuple(dict.fromkeys(free, torch.export.Dim.DYNAMIC) for free in graph.free)
    with torch.no_grad():
        program = torch.export.export(module, graph.example, dynamic_shapes=axes)
    # Example inputs would be pickled, guards are Python code, and notes hold paths of this machine.
    program.example_inputs = None
    program._guards_code.clear()
    # The exporter distrusts lengths at which a size inside would be 1; our modules have no branches to fear.
    for symbol in program.range_constraints:
        program.range_constraints[symbol] = ValueRanges(1, int_oo)
    # It also checks lengths that data decide, by operators that files may not call.
    for node in program.graph.nodes:
        if node.target is torch.ops.aten._assert_scalar.default:
            program.graph.erase_node(node)
    program.graph.eliminate_dead_code()
    for node in program.graph.nodes:
        for note in NOTES:
            node.meta.pop(note, None)
    archive = io.BytesIO()
    torch.export.save(program, archive, extra_files={KEY: manifest.text()})
    with atomic.replacing(path) as partial:
        partial.write_bytes(archive.getvalue())
        tensor_files.fill_archive_digest(partial)


def read(path: Path) -> tuple[NetworkFunction, Manifest]:
    """An archive that `write` wrote, ready to run, and its manifest.

    Raises:
        CheckpointError: `write` did not write the file, or it could do more than compute.
    """
    try:
        has_digest = tensor_files.check_archive_digest(path)
        _check(path)
        texts = {KEY: ""}
        program = torch.export.load(path, extra_files=texts)
        manifest = parse(path, texts[KEY] or None, has_digest)
        for name, weight in (*program.state_dict.items(), *program.constants.items()):
            if not bool(weight.isfinite().all()):
                raise _refusal(path, f"{name[:80]}, which is not finite")
        module = program.module(check_guards=False)
    except CheckpointError:
        raise
    # On a foreign file PyTorch raises any error.
    except Exception as error:
        raise CheckpointError(
            f"{path} must be an archive of torch.export", got=first_line(error), remedy="export it anew"
        ) from error

    # A function, since a module would become a part of the module that holds it.
    def run(*inputs: Tensor) -> Tensor:
        stack: Tensor = module(*inputs)
        return stack

    return run, manifest


def _check(path: Path) -> None:
    """Refuse an archive with which PyTorch would do more than compute."""
    with zipfile.ZipFile(path) as archive:
        members = {member.filename.partition("/")[2]: member for member in archive.infolist()}
        if path.stat().st_size > LARGEST or sum(member.file_size for member in members.values()) > LARGEST:
            raise _refusal(path, "more than 8 GiB")
        # If two members had one name, another reader might see the other member.
        if len(members) < len(archive.infolist()):
            raise _refusal(path, "members of one name")
        for name, member in members.items():
            is_empty_input = name == SAMPLE_INPUTS and member.file_size == 0
            if member.compress_type != zipfile.ZIP_STORED or not (is_empty_input or MEMBERS.fullmatch(name)):
                raise _refusal(path, name[:80])
            if name.endswith((".json", f"/{KEY}")) and member.file_size > LARGEST_TEXT:
                raise _refusal(path, f"{member.file_size} bytes of {name}")
        for name, member in members.items():
            if name.endswith(".json"):
                text = json.loads(archive.read(member))
                _check_text(path, text)
                if name.startswith("data/"):
                    _check_sizes(path, text, name.rpartition("/")[0], members)
                else:
                    _check_nodes(path, text["graph_module"]["graph"]["nodes"])


def _check_text(path: Path, text: Any) -> None:
    """Refuse pickles, Python code, and names of modules and functions in a text of an archive."""
    n_graphs = 0
    for key, value in _pairs(text):
        n_graphs += key == "nodes"
        is_text = isinstance(value, str) and len(value) <= LONGEST_EXPRESSION
        is_code = (
            key in ("use_pickle", "guards_code", "treespec_namedtuple_fields", "as_custom_obj", "as_graph") and value
        )
        is_expression = key != "expr_str" or (is_text and EXPRESSION.fullmatch(value))
        is_specification = key not in ("in_spec", "out_spec") or (is_text and SPECIFICATION.fullmatch(value))
        if is_code or not (is_expression and is_specification) or n_graphs > 1:
            raise _refusal(path, f"{key} {str(value)[:80]!r}")


def _check_nodes(path: Path, nodes: list[dict[str, Any]]) -> None:
    """Refuse operators and kinds of arguments that no network of ours needs."""
    for node in nodes:
        target = str(node["target"])
        allowed = {f"as_{kind}" for kind in OPERATORS.get(target, "").split()}
        kinds = {kind for argument in node["inputs"] for kind in argument["arg"]}
        if not allowed or kinds - allowed or any(note in node["metadata"] for note in ("custom", "from_node")):
            raise _refusal(path, f"{target[:80]} of {', '.join(sorted(kinds - allowed)) or 'any arguments'}")


def _check_sizes(path: Path, text: Any, folder: str, members: Mapping[str, zipfile.ZipInfo]) -> None:
    """Refuse weights of other types, and weights whose size differs from the size of their member of the archive."""
    for name, entry in text["config"].items():
        meta = entry["tensor_meta"]
        sizes = [int(size["as_int"]) for size in meta["sizes"]]
        size = BYTES.get(meta["dtype"], 0) * math.prod(sizes)
        if meta["dtype"] not in BYTES or members[f"{folder}/{entry['path_name']}"].file_size != size:
            raise _refusal(path, f"{name[:80]} of another size")


def _pairs(text: Any) -> Iterator[tuple[str, Any]]:
    """All pairs (key, value) of all mappings; the search has no recursion, which deep nesting would break."""
    waiting = [text]
    while waiting:
        part = waiting.pop()
        if isinstance(part, dict):
            yield from part.items()
            waiting += part.values()
        elif isinstance(part, list):
            waiting += part


def _refusal(path: Path, got: str) -> CheckpointError:
    return CheckpointError(
        f"{path} must hold plain weights, and a graph of the operators of lfref's networks",
        got=got,
        remedy="export it anew",
    )
