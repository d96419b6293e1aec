"""A GPU that is none: tensors that say they lie on another device, compute on the CPU, and refuse what a GPU refuses.

Within `with Gpu() as gpu:` code may make tensors on DEVICE. Mixing devices is an error, and so is what makes the host
wait for the GPU, unless `may_wait`. Operations are counted as PyTorch dispatches them, which is about what a GPU runs.
The first use gives PyTorch's spare device `privateuseone` what it asks of a device. From then on the autograd engine
has a thread for it, so that this process can no longer fork trainings.
"""

import functools
import sys
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils import backend_registration
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

DEVICE = torch.device("privateuseone:0")
INDEXING = ("index", "index_put", "index_put_", "_index_put_impl_", "_unsafe_index", "_unsafe_index_put")
"""Operations that take indices from the CPU on a GPU too; for a mask on the GPU the host waits for its count."""
WAITING = {
    "_local_scalar_dense", "nonzero", "argwhere", "masked_select", "_unique2", "unique_dim", "unique_consecutive",
    "equal", "allclose", "histc", "bincount", "multinomial", "_linalg_check_errors", "cholesky", "_linalg_svd",
    "_linalg_eigh", "linalg_eig", "_linalg_eigvals", "linalg_lstsq", "linalg_pinv", "linalg_matrix_exp",
}  # fmt: skip
UNCOUNTED = {"_unsafe_view", "is_pinned", "_local_scalar_dense", "_linalg_check_errors", "scalar_tensor"}
"""No views, yet no kernels. A `scalar_tensor` is a Python number, which a GPU mostly takes as a kernel's argument."""
ROOT, NOT_CALLERS = Path(__file__).parents[1], (str(Path(torch.__file__).parent), __file__)


@functools.cache
def registered() -> tuple[Any, Any]:
    """What PyTorch asks of a device, which has to live on."""
    backend, guard = backend_registration._DummyBackendModule(), backend_registration._DummyDeviceGuard()
    backend.get_amp_supported_dtype = lambda: [torch.float16, torch.bfloat16]  # what `torch.autocast` asks
    torch._register_device_module(DEVICE.type, backend)
    torch._C._acc.register_python_privateuseone_device_guard(guard)
    return backend, guard


class Pretended(Tensor):
    """A tensor of the CPU, `inner`, that pretends; `is_number` if PyTorch made it of a Python number."""

    inner: Tensor
    is_number = False
    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, inner: Tensor) -> "Pretended":
        registered()
        # Conjugates are computed at once: PyTorch would not see that the wrapper is a lazy one.
        inner = inner.resolve_conj().resolve_neg()
        shape, strides, offset = inner.shape, inner.stride(), inner.storage_offset()
        made = Tensor._make_wrapper_subclass(cls, shape, strides, offset, dtype=inner.dtype, device=DEVICE)
        made.inner = inner
        return made

    @classmethod
    def __torch_dispatch__(cls, function: Any, types: Any, arguments: Any = (), options: Any = None) -> Any:
        return Gpu(may_wait=True).__torch_dispatch__(function, types, arguments, options)

    def tolist(self) -> Any:
        return self.cpu().tolist()

    def __format__(self, form: str) -> str:
        return format(self.item() if self.ndim == 0 else repr(self), form)

    def __repr__(self) -> str:  # type: ignore[override]
        return f"on_gpu({on_cpu(self)!r})"


class Gpu(TorchDispatchMode):
    """A context in which tensors can be made on the GPU that is none; it counts and refuses."""

    def __init__(self, may_wait: bool = False) -> None:
        registered()
        super().__init__()
        self.may_wait = may_wait
        self.n_operations = 0  # on the GPU; no views, no copies from or to the CPU
        self.n_host_operations = 0  # on the CPU, reading or making more than one element; no views
        self.waits: list[str] = []  # NAME at FILE:LINE

    def __enter__(self) -> "Gpu":
        # `torch.tensor(..., device=DEVICE)` then makes its tensor on the CPU, and copies it where this mode sees it.
        self._lifted = torch._C._only_lift_cpu_tensors()
        torch._C._set_only_lift_cpu_tensors(True)
        return super().__enter__()

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        torch._C._set_only_lift_cpu_tensors(self._lifted)

    def __torch_dispatch__(self, function: Any, types: Any, arguments: Any = (), options: Any = None) -> Any:
        name, options = function.__name__.split(".")[0], options or {}
        tensors, wanted = tensors_of((arguments, options)), options.get("device")
        where = map(type, arguments[:1] if name == "copy_" else tensors)
        is_ours = Pretended in where if wanted is None else torch.device(wanted).type == DEVICE.type
        is_copy = name in ("copy_", "_to_copy") and is_ours != (type(tensors[-1]) is Pretended)
        if is_copy:
            # A copy to the GPU waits too, unless the code says that it need not.
            is_queued = options.get("non_blocking") or arguments[2:3] == (True,)
            if not (is_ours and (is_queued or tensors[-1].numel() < 2)):
                self._wait(name)
        elif Pretended in map(type, tensors):
            self._check(name, arguments, options, tensors)
        result = computed(function, arguments, options, tensors, is_ours)
        is_view = (function.is_view and name != "_conj") or torch.Tag.inplace_view in function.tags
        if not (is_copy or is_view or name in UNCOUNTED or name.startswith(("empty", "new_empty"))):
            self.n_operations += is_ours
            self.n_host_operations += not is_ours and any(t.numel() > 1 for t in [*tensors, *tensors_of(result)])
        if is_ours and name == "scalar_tensor":
            result.is_number = True
        return result

    def _check(self, name: str, arguments: Any, options: dict[str, Any], tensors: list[Tensor]) -> None:
        """Refuse tensors of both devices; record waits and the copies of indices."""
        indices = tensors_of(arguments[1]) if name in INDEXING else []
        copied = [i for i in indices if type(i) is not Pretended] if type(arguments[0]) is Pretended else []
        allowed = {id(tensor) for tensor in tensors if type(tensor) is Pretended or tensor.ndim == 0}
        if any(id(tensor) not in allowed.union(map(id, copied)) for tensor in tensors):
            raise RuntimeError(f"tensors of the CPU and of a GPU meet in {name} at {place()}")
        if any(index.numel() > 1 for index in copied):
            self._wait(name)
        # `x[mask] = 0` is `masked_fill_` on a GPU.
        is_fill = "put" in name and len(indices) == 1 and getattr(arguments[2], "is_number", True)
        is_masked = any(i.dtype in (torch.bool, torch.uint8) for i in indices if type(i) is Pretended) and not is_fill
        is_unknown_size = name == "repeat_interleave" and options.get("output_size") is None
        if name in WAITING or is_masked or is_unknown_size or options.get("check_errors"):
            self._wait(name)

    def _wait(self, name: str) -> None:
        self.waits.append(f"{name} at {place()}")
        if not self.may_wait:
            raise RuntimeError(f"the host waits in {self.waits[-1]}")


def on_gpu(tensor: Tensor) -> Tensor:
    """The tensor, as if it lay on a GPU; not recorded."""
    with torch._C._DisableTorchDispatch():
        return Pretended(tensor.detach().clone())


def on_cpu(tensor: Tensor) -> Tensor:
    """The values of a tensor, on the CPU; not recorded."""
    with torch._C._DisableTorchDispatch():
        return inner_of(tensor).clone()


def inner_of(part: Any) -> Any:
    return part.inner if isinstance(part, Pretended) else part


def tensors_of(parts: Any) -> list[Tensor]:
    return [part for part in tree_leaves(parts) if isinstance(part, Tensor)]


def computed(function: Any, arguments: Any, options: dict[str, Any], tensors: list[Tensor], is_ours: bool) -> Any:
    """Result of an operation on the inner tensors, on the device where it belongs."""
    if is_ours and options.get("device") is not None:
        options = {**options, "device": torch.device("cpu")}
    result = function(*tree_map(inner_of, arguments), **tree_map(inner_of, options))
    if torch.Tag.inplace_view in function.tags and is_ours:
        with torch._C._DisableTorchDispatch():  # the wrapper takes its new shape too
            function(*arguments, **options)
    given = {id(inner_of(tensor)): tensor for tensor in tensors}  # operations in place return what they were given
    result = tree_map(lambda part: given.get(id(part), part), result)
    return tree_map(lambda part: Pretended(part) if is_ours and type(part) is Tensor else part, result)


def place() -> str:
    """FILE:LINE of the code that called PyTorch."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(NOT_CALLERS):
        frame = frame.f_back
    file = Path(frame.f_code.co_filename)
    return f"{(file.relative_to(ROOT) if file.is_relative_to(ROOT) else file).as_posix()}:{frame.f_lineno}"
