"""A GPU that is none: tensors that say they lie on `cuda:0`, compute on the CPU, and refuse what a GPU would refuse.

`on_gpu(tensor)` makes one, for code within `with WithGpu()`. Mixing it with a tensor of the CPU that has dimensions,
and calling `numpy()` on it, are errors, as on a GPU. The module patches PyTorch: use it in a process of its own.
"""

from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

DEVICE = torch.device("cuda:0")
INDEXING = ("index", "index_put", "index_put_", "_index_put_impl_", "_unsafe_index")
"""Operations that take indices from the CPU on a GPU too."""
COPYING = ("copy_", "_to_copy")

torch.cuda._lazy_init = lambda: None
_to, _tensor, _as_tensor = Tensor.to, torch.tensor, torch.as_tensor


class Pretended(Tensor):
    """A tensor of the CPU, `inner`, that pretends."""

    @staticmethod
    def __new__(cls, inner: Tensor) -> "Pretended":
        return Tensor._make_wrapper_subclass(
            cls, inner.shape, dtype=inner.dtype, device="meta", strides=inner.stride(),
            storage_offset=inner.storage_offset(),
        )  # fmt: skip

    def __init__(self, inner: Tensor) -> None:
        self.inner = inner

    device = property(lambda self: DEVICE)
    is_cuda = property(lambda self: True)
    is_meta = property(lambda self: False)

    def cpu(self) -> Tensor:
        return self.inner.clone()

    def tolist(self) -> Any:
        return self.inner.tolist()

    def data_ptr(self) -> int:
        return self.inner.data_ptr()

    def untyped_storage(self) -> Any:
        return self.inner.untyped_storage()

    def numpy(self, *_: Any, **__: Any) -> Any:
        raise TypeError("can't convert cuda:0 device type tensor to numpy. Use Tensor.cpu()")

    __array__ = numpy

    def to(self, *arguments: Any, **options: Any) -> Tensor:
        return moved(self, *arguments, **options)

    @classmethod
    def __torch_dispatch__(cls, function: Any, types: Any, arguments: Any = (), options: Any = None) -> Any:
        return dispatched(function, arguments, options or {})


class WithGpu(TorchDispatchMode):
    """A context in which tensors can be made on the GPU that is none."""

    def __torch_dispatch__(self, function: Any, types: Any, arguments: Any = (), options: Any = None) -> Any:
        return dispatched(function, arguments, options or {})


def on_gpu(tensor: Tensor) -> Tensor:
    """The tensor, as if it lay on a GPU."""
    return Pretended(tensor)


def dispatched(function: Any, arguments: Any, options: dict[str, Any]) -> Any:
    """Run an operation on the inner tensors; refuse what mixes devices."""
    name = function.__name__.split(".")[0]
    tensors = [part for part in tree_flatten((arguments, options))[0] if isinstance(part, Tensor)]
    pretended = [tensor for tensor in tensors if isinstance(tensor, Pretended)]
    others = [tensor for tensor in tensors if not isinstance(tensor, Pretended) and tensor.ndim > 0]
    if pretended and others and name not in (*INDEXING, *COPYING):
        raise RuntimeError(f"tensors of the CPU and of a GPU meet in {name}")
    if name in INDEXING and not isinstance(arguments[0], Pretended) and pretended:
        raise RuntimeError(f"an index on a GPU and a tensor of the CPU meet in {name}")
    wanted = options.get("device")
    if wanted is not None:
        options = {**options, "device": torch.device("cpu")}
    result = function(*tree_map(inner, arguments), **tree_map(inner, options))
    is_in_place = name.endswith("_") and not name.startswith("_")
    if is_in_place and isinstance(arguments[0], Pretended):
        return arguments[0]
    goes_to_gpu = bool(pretended) if wanted is None else torch.device(wanted).type in ("cuda", "meta")
    if not goes_to_gpu or name == "_local_scalar_dense":
        return result
    return tree_map(lambda part: Pretended(part) if type(part) is Tensor else part, result)


def inner(part: Any) -> Any:
    """What a pretended tensor computes with; anything else as it is."""
    return part.inner if isinstance(part, Pretended) else part


def moved(self: Tensor, *arguments: Any, **options: Any) -> Tensor:
    """`Tensor.to` between the CPU and the GPU that is none."""
    parts = [*arguments, *options.values()]
    device = next((part for part in parts if isinstance(part, str | torch.device)), None)
    like = next((part for part in parts if isinstance(part, Tensor)), None)
    dtype = next((part for part in parts if isinstance(part, torch.dtype)), None if like is None else like.dtype)
    on_it = isinstance(self, Pretended)
    if like is not None:
        on_it = isinstance(like, Pretended)
    elif device is not None:
        on_it = torch.device(device).type == "cuda"
    held = inner(self)
    held = held if dtype is None else _to(held, dtype)
    return Pretended(held) if on_it else held


def made(make: Any) -> Any:
    """`torch.tensor` or `torch.as_tensor`, which may be asked for a tensor on the GPU or given one."""

    def wrapped(data: Any, *arguments: Any, device: Any = None, **options: Any) -> Tensor:
        on_it = isinstance(data, Pretended) if device is None else torch.device(device).type == "cuda"
        tensor = make(inner(data), *arguments, **options)
        return Pretended(tensor) if on_it else tensor

    return wrapped


def new_tensor(self: Tensor, data: Any, **options: Any) -> Tensor:
    """`Tensor.new_tensor`."""
    tensor = _tensor(data, dtype=options.get("dtype", self.dtype))
    return Pretended(tensor) if isinstance(self, Pretended) else tensor


Tensor.to = moved  # type: ignore[method-assign]
Tensor.new_tensor = new_tensor  # type: ignore[method-assign]
torch.tensor, torch.as_tensor = made(_tensor), made(_as_tensor)
