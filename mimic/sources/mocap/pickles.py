"""Reads arrays out of pickles without executing them: .pkl by pickle or joblib, .pt by PyTorch.

Pickles may name any function. Only the few that rebuild NumPy arrays, PyTorch tensors and plain containers are known
here; anything else ends the reading. PyTorch and joblib are not needed.
"""

from __future__ import annotations

import collections
import io
import math
import pickle
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from mimic.errors import SourceError


def read_pickle(path: Path) -> Any:
    """Return the plain data and arrays in a pickle.

    Raises:
        SourceError: If the file is none, or needs code to be read.
    """
    try:
        with open(path, "rb") as file:
            if zipfile.is_zipfile(file):
                return _torch(path)
        return _Reader(io.BytesIO(_unpacked(path))).load()
    except SourceError:
        raise
    except _NotPlain as error:
        raise SourceError(
            f"{path.name} holds a Python object ({error}), which is not read; store plain arrays"
        ) from None
    except Exception as error:  # a broken pickle can fail in any way
        raise SourceError(
            f"{path.name} cannot be read as a pickle of arrays ({type(error).__name__}: {str(error)[:80]})"
        ) from None


class _NotPlain(Exception):
    """A pickle names something that is no plain data."""


def _unpacked(path: Path) -> bytes:
    """Return the bytes of a file, unpacked if joblib packed them."""
    data = path.read_bytes()
    return zlib.decompress(data) if data[:1] == b"\x78" else data


class _JoblibArray:
    """Stands for joblib's NumpyArrayWrapper: the array's bytes follow it in the file."""

    state: dict[str, Any]

    def read(self, file: io.BytesIO) -> np.ndarray:
        shape = tuple(int(n) for n in self.state["shape"])
        if self.state.get("numpy_array_alignment_bytes") is not None:
            file.read(file.read(1)[0])  # padding
        dtype = _dtype(self.state["dtype"])
        return _frombuffer(file.read(math.prod(shape) * dtype.itemsize), dtype, shape, self.state.get("order"))


_STORAGES = {
    **{"FloatStorage": np.float32, "DoubleStorage": np.float64, "HalfStorage": np.float16, "BoolStorage": np.bool_},
    **{"LongStorage": np.int64, "IntStorage": np.int32, "ShortStorage": np.int16, "CharStorage": np.int8},
    "ByteStorage": np.uint8,
}
"""NumPy's types of PyTorch's storages."""


def _tensor(storage: np.ndarray, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any) -> np.ndarray:
    """Rebuild a tensor as an array."""
    step = storage.itemsize
    strides = [int(n) * step for n in stride]
    return np.ndarray(size, storage.dtype, storage, int(offset) * step, strides).copy()  # refuses what goes beyond it


class _NdArray:
    """Stands for numpy.ndarray, which would build an array on any bytes."""


def _rebuild_array(kind: Any, shape: Any, typecode: Any) -> np.ndarray:
    return np.empty(0, dtype="b")


def _dtype(kind: Any, *_: Any) -> np.dtype:
    """Return a type of numbers or text of its own; types that hold addresses of objects are none."""
    found = np.dtype(kind) if isinstance(kind, str | np.dtype) else None
    if found is None or found.hasobject or found.kind not in "biufcSU":
        raise _NotPlain(f"an array of {kind}"[:60])
    return np.dtype(found, copy=True)


def _scalar(dtype: np.dtype, data: bytes) -> Any:
    return np.frombuffer(data, dtype=_dtype(dtype), count=1)[0]


def _frombuffer(data: Any, dtype: np.dtype, shape: Any, order: Any) -> np.ndarray:
    return np.frombuffer(data, dtype=_dtype(dtype)).reshape(shape, order="F" if order == "F" else "C")


_KNOWN: dict[str, Any] = {
    "numpy.ndarray": _NdArray,
    "numpy.dtype": _dtype,
    "collections.OrderedDict": collections.OrderedDict,
    "collections.defaultdict": lambda *_: {},
    "builtins.dict": dict,
    "builtins.list": list,
    "builtins.int": int,
    "builtins.float": float,
    "_codecs.encode": lambda text, encoding: text.encode("latin1"),
    "joblib.numpy_pickle.NumpyArrayWrapper": _JoblibArray,
    "torch._utils._rebuild_tensor_v2": _tensor,
}
for _module in ("numpy.core", "numpy._core"):
    _KNOWN[f"{_module}.multiarray._reconstruct"] = _rebuild_array
    _KNOWN[f"{_module}.multiarray.scalar"] = _scalar
    _KNOWN[f"{_module}.numeric._frombuffer"] = _frombuffer


class _Reader(pickle._Unpickler):  # the Python one: joblib's arrays follow their BUILD
    """An unpickler that knows plain containers and arrays only."""

    stack: list[Any]

    def __init__(self, file: io.BytesIO, storages: Callable[[Any], np.ndarray] | None = None) -> None:
        super().__init__(file, encoding="latin1")
        self.file = file
        self.storages = storages

    def find_class(self, module: str, name: str) -> Any:
        full = f"{module}.{name}"
        if module == "torch" and name.endswith("Storage"):
            return name
        if full not in _KNOWN:
            raise _NotPlain(full[:60])
        return _KNOWN[full]

    def persistent_load(self, pid: Any) -> np.ndarray:
        if self.storages is None:
            raise _NotPlain("a reference to another file")
        return self.storages(pid)

    def load_build(self) -> None:
        """Give an object its state: arrays and their types only, and no other than NumPy itself writes."""
        state = self.stack.pop()
        given = self.stack[-1]
        if isinstance(given, _JoblibArray):
            given.state = state
            self.stack[-1] = given.read(self.file)
        elif isinstance(given, np.dtype):
            if state[2:8] != given.__reduce__()[2][2:8]:
                raise _NotPlain("an array with fields")
            given.__setstate__(state[:8])  # pyrefly: ignore[missing-attribute]  # not in its stubs
        elif isinstance(given, np.ndarray):
            _, shape, dtype, _, data = state
            sizes = [int(n) for n in shape]
            size = _dtype(dtype).itemsize
            if min((0, *sizes)) < 0 or not isinstance(data, bytes | str) or size * math.prod(sizes) != len(data):
                raise _NotPlain("an array of another size than its bytes")
            given.__setstate__(state)

    dispatch: ClassVar[dict[int, Any]] = {**pickle._Unpickler.dispatch, pickle.BUILD[0]: load_build}


def _torch(path: Path) -> Any:
    """Return the data of a file of torch.save: a zip of a pickle and the bytes of each storage."""
    with zipfile.ZipFile(path) as archive:
        main = next((name for name in archive.namelist() if name.endswith("/data.pkl")), None)
        if main is None:
            raise SourceError(f"{path.name} is an archive without data.pkl; expected a file of torch.save")
        folder = main.removesuffix("data.pkl")

        def storage(pid: Any) -> np.ndarray:
            _, kind, key, _, count = pid
            if kind not in _STORAGES:
                raise _NotPlain(f"torch.{kind}")
            return np.frombuffer(archive.read(f"{folder}data/{key}"), dtype=_STORAGES[kind], count=count)

        return _Reader(io.BytesIO(archive.read(main)), storage).load()
